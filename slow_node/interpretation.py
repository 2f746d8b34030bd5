"""What a command is interpreted with and as: what was said before it, the reader's word, and what comes of it."""

from __future__ import annotations

from dataclasses import dataclass

from schemas.wire.messages import Verdict
from schemas.wire.program import Program
from slow_node.memory.bank import Example
from slow_node.understanding.slots import Slots


@dataclass(frozen=True)
class Context:
    """What was said before and what has become of it: the rest of P_t."""

    turns: tuple[str, ...] = ()
    """What was asked for before, in brief; the newest last."""
    wishes: str = ""
    """What stands of it."""
    delayed: str = ""
    """The manoeuvre before this command that the fast node is delaying."""
    delayed_by: str = ""
    """The rule by which it does."""
    again: str = ""
    """Why the model is asked once more about a command that is being carried out; "": it is new."""
    standing: Program | None = None
    """What is being carried out for it."""


@dataclass(frozen=True)
class Interpretation:
    """What a command was found to mean: slots, or none and why."""

    slots: Slots | None
    why: str = ""
    model_answered: bool = True
    """False where no model could be reached and nothing else could help: a failure, not a refusal."""
    model_ms: float = 0.0
    source: str = ""
    """Who decided: "refusals", "parser", "memory" or the language model's name."""
    nearest: tuple[Example, ...] = ()
    program: Program | None = None
    """The command as a script; None: what the slots say, at once."""
    model_asked: bool = False
    lesson: str = ""
    """What experience on a road like this one says about it."""
    provisional: bool = False
    """The reader's, to be acted on until the model has answered."""
    verdict: Verdict = ""
    """What the model's answer did to the reader's."""
    confidence: float = 0.0
    """Of the reader's reading."""
    model_confidence: float = 0.0
    """Of the model's answer, as far as it is trusted."""

    @property
    def model_decided(self) -> bool:
        """The model's answer is followed where the reader's was another, or none."""
        return self.verdict in ("refined", "withdrew", "decided")


@dataclass(frozen=True)
class Read:
    """What the program reader made of a command, with its summary on this road."""

    slots: Slots
    confidence: float
    refused: float
    program: Program
    sure: bool

    @property
    def trust(self) -> float:
        """The probability that it is right."""
        return 1.0 if self.sure else self.confidence
