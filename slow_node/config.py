"""The slow node's configuration."""

from __future__ import annotations

from typing import Literal

from schemas.runtime.process import NodeConfig

THOUGHTS = "thoughts.jsonl"
"""In a run's folder: how each command was understood."""
WISHES = "wishes.json"
"""In a run's folder: the wishes that are open."""
TOKEN = "FASTSLOW_MODEL_TOKEN"
"""The environment variable with what the embedded model's server must be shown."""
BUDGET_S, BUDGET_MAX_S = 8.0, 300.0


class SlowConfig(NodeConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which model to ask, and how. The key is read from the environment variable named here, never from a file."""

    base_url: str = "https://api.openai.com/v1"
    """Any OpenAI-compatible endpoint; for the embedded model http://127.0.0.1:PORT/v1."""
    model: str = "gpt-4o-mini"
    api_key_env: str = "OPENAI_API_KEY"
    embedded: bool = True
    """Short prompt and short answers, for a small model on one core; its server is shown `TOKEN`, never a key."""
    adapter: bool = True
    """The embedded model has its adapter, and is asked as that has learnt it; False: with recalled examples."""
    memory_path: str = ""
    """SQLite file of the memory bank; empty: a bank that ends with the process."""
    thoughts_path: str = ""
    """A JSONL file that every thought is appended to, whole; empty: none."""
    wishes_path: str = ""
    """A JSON file of the wishes that are open, for the process that may have to come after this one; empty: none."""
    budget_s: float = BUDGET_S
    """How long the language model may take for one command, retries included. What its answer was thought for may be
    as old."""
    max_tokens: int = 0
    """Of an answer, thoughts included; 0: as `slow_node.llm.model` has it."""
    k: int = 4
    """Examples recalled for the language model; 0: none."""
    ask: Literal["auto", "always", "unsure", "never"] = "auto"
    """When the language model is asked; `auto`: always; a model of one's own in the embedded one's place
    only where the reader is unsure, for nobody has measured it."""
    parser: bool = True
    """False: without the trained intent parser, the language model alone (for measurements)."""
    shipped_examples: bool = True
    """False: the memory bank starts empty (for measurements)."""

    def __post_init__(self) -> None:
        if not self.base_url.startswith(("http://", "https://")):
            raise ValueError(f"base_url {self.base_url!r} must start with http:// or https://")
        if not 0.5 <= self.budget_s <= BUDGET_MAX_S:
            raise ValueError(f"budget_s must be in 0.5..{BUDGET_MAX_S:.0f}")
        if self.max_tokens < 0:
            raise ValueError("max_tokens must be at least 1, or 0 for the default")
        if not 0 <= self.k <= 8:
            raise ValueError("k must be in 0..8")
