"""What the slow system's state machine asks its shell to do."""

from __future__ import annotations

from dataclasses import dataclass, field

from schemas.wire.messages import Directive, Event, Reply
from slow_node.interpretation import Context
from slow_node.memory.bank import Memory
from slow_node.memory.preferences import Preference
from slow_node.planning.scene import Scene, describe
from slow_node.understanding.slots import Slots


@dataclass(frozen=True)
class Interpret:
    """Effect: find out what a command means. At most one is in flight; a newer one replaces it."""

    id: int
    command_id: int
    command: str
    scene: Scene
    context: Context = field(default_factory=Context)


@dataclass(frozen=True)
class Abandon:
    """Effect: the interpretation in flight is of no use any more."""


@dataclass(frozen=True)
class Remember:
    """Effect: keep a decision and what came of it in the memory bank."""

    command: str
    scene: Scene
    slots: Slots
    outcome: str
    """"fulfilled", "expired", "superseded" or "cancelled"; with the reason that held it up, where one did."""
    took_s: float
    """From the directive to its end."""
    min_ttc_s: float
    """Smallest time to collision meanwhile (`Scene.ttc_s`); inf: the ego never closed in on anybody."""


@dataclass(frozen=True)
class Prefer:
    """Effect: keep what the passenger prefers on every drive, or forget it."""

    kind: str
    said: str
    holds: bool


def keep(memory: Memory, effect: Remember | Prefer) -> None:
    """Write one to the memory bank. May wait for other processes; raises what SQLite does."""
    match effect:
        case Remember():
            scene = describe(effect.scene)
            memory.learn(effect.command, scene, effect.slots, effect.outcome, effect.took_s, effect.min_ttc_s)
        case Prefer(holds=True):
            memory.prefer(Preference(effect.kind, effect.said))
        case Prefer():
            memory.drop(effect.kind)


Effect = Prefer | Interpret | Abandon | Remember | Directive | Reply | Event
