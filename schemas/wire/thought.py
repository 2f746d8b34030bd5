"""How a command was understood, for people who look: read as the messages in `messages.py` are."""

from __future__ import annotations

from msgspec import Struct

from schemas.wire.messages import Message, Verdict


class Turn(Struct, frozen=True, kw_only=True):
    """One message of a prompt to the language model."""

    role: str
    content: str


class Recalled(Struct, frozen=True, kw_only=True):
    """One example out of the memory bank."""

    command: str
    similarity: float
    """Cosine of the two commands."""
    slots: str
    """What it was taken to mean, as JSON."""
    outcome: str
    """What came of it the last time."""


class Try(Struct, frozen=True, kw_only=True):
    """One exchange with the language model's server."""

    ms: float
    asked: str
    """The answer format that was asked for: "json_schema", "json_object" or "text"."""
    failed: str = ""
    """Why no answer came, in the server's words where it had some; "": one came."""
    unusable: str = ""
    """Why the answer could not be parsed; "": it could."""
    thinking: str = ""
    """What the model thought before it answered: never read for what it means."""
    finish: str = ""
    """Why the answer ended, in the server's word."""
    prompt_tokens: int = 0
    answer_tokens: int = 0


class Thought(Message, frozen=True, kw_only=True, tag="thought"):
    """How a command was understood: for people who look. Nothing is driven by it, and long texts are cut off."""

    command_id: int
    command: str
    source: str
    """Who decided: "refusals", "parser", "memory" or the language model's name."""
    outcome: str
    """Of the first reply after it: "issued", "refused" or "failed"; "superseded" where a newer command came first."""
    reading: str = ""
    """What the intent parser made of it."""
    recalled: tuple[Recalled, ...] = ()
    prompt: tuple[Turn, ...] = ()
    """Empty where the language model was not asked."""
    answers: tuple[str, ...] = ()
    """The language model's, as they came; the second is a repair."""
    guards: tuple[str, ...] = ()
    """What was changed of the answer, or why it was not followed."""
    slots: str = ""
    """What the command was taken to mean in the end, as JSON."""
    spans_ms: dict[str, float] = {}
    """How long each part took."""
    prompt_tokens: int = 0
    answer_tokens: int = 0
    trimmed: bool = False
    """Something was too long and is cut off."""
    model: str = ""
    """The language model that was asked; "": none was."""
    tries: tuple[Try, ...] = ()
    """Every exchange with its server: retries, other ways of asking, repairs."""
    cost_usd: float | None = None
    """Of them all; None: nobody knows."""
    verdict: Verdict = ""
    again: str = ""
    """Why the model was asked once more about a command under way; "": the command was new."""
