"""The embedded model's adapter, and what is known of it: what it answers, and how far its own odds go."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec
from msgspec import Struct

from schemas.runtime.process import ConfigError

ADAPTER = Path(__file__).parents[1] / "weights" / "adapter.gguf"
"""What `python -m slow_node.training.fine_tune` has learnt."""


class Adapter(Struct, frozen=True):
    """What the file beside the weights says of them; other keys are for people."""

    answers: Literal["slots", "programs"] = "slots"
    trust: float = 0.5
    """What its probability of an answer is worth where the reader's is another: docs/understanding.md."""


def read_adapter(path: Path = ADAPTER) -> Adapter:
    """What is known of an adapter. Raises `ConfigError`."""
    about = path.with_suffix(".json")
    try:
        return msgspec.json.decode(about.read_bytes(), type=Adapter)
    except (OSError, msgspec.MsgspecError) as error:
        raise ConfigError(f"{about} cannot be read: {str(error).splitlines()[0]}; install fastslow again") from None
