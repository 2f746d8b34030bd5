"""The one table of what flows: read by the nodes, the supervisor, the recorder, the benchmark and the docs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from schemas.wire import messages as m
from schemas.wire.journal import Journal
from schemas.wire.thought import Thought

M = TypeVar("M", bound=m.Message)

PREFIX = "fastslow/ego"
MAX_MESSAGE_BYTES = 3072
"""A larger payload is refused on both sides: zenoh would move it to shared memory, and a tick must stay small."""
MAX_THOUGHT_BYTES = 16_384
"""Of a thought alone, which is prose, concerns no tick and travels to no critical node."""
MAX_COMMAND_CHARS = 500
"""A longer command is refused with a reason."""


@dataclass(frozen=True, kw_only=True)
class Topic(Generic[M]):
    """One key of the bus.

    `hz` is the nominal rate (None: when it happens). A sample older than `stale_after_s` counts as absent.
    `depth` is how many samples a reader keeps: the newest win, older ones are dropped. Every topic is published with
    congestion control DROP: a timed loop never waits for a reader.
    """

    name: str
    type: type[M]
    hz: float | None
    stale_after_s: float
    depth: int
    max_bytes: int = MAX_MESSAGE_BYTES

    @property
    def key(self) -> str:
        return f"{PREFIX}/{self.name}"


OBSERVATION = Topic(name="observation", type=m.Observation, hz=15, stale_after_s=0.2, depth=1)
ACTION = Topic(name="action", type=m.Action, hz=15, stale_after_s=0.02, depth=4)
DIRECTIVE = Topic(name="directive", type=m.Directive, hz=None, stale_after_s=60.0, depth=1)
COMMAND = Topic(name="command", type=m.Command, hz=None, stale_after_s=10.0, depth=8)
REPLY = Topic(name="reply", type=m.Reply, hz=None, stale_after_s=60.0, depth=16)
EVENT = Topic(name="event", type=m.Event, hz=None, stale_after_s=60.0, depth=64)
STATUS = Topic(name="status", type=m.Status, hz=5, stale_after_s=1.0, depth=16)
THOUGHT = Topic(name="thought", type=Thought, hz=None, stale_after_s=60.0, depth=8, max_bytes=MAX_THOUGHT_BYTES)
CONTROL = Topic(name="control", type=m.Control, hz=None, stale_after_s=10.0, depth=8)
JOURNAL = Topic(name="journal", type=Journal, hz=None, stale_after_s=60.0, depth=64)

TOPICS: tuple[
    Topic[m.Observation]
    | Topic[m.Action]
    | Topic[m.Directive]
    | Topic[m.Command]
    | Topic[m.Reply]
    | Topic[m.Event]
    | Topic[m.Status]
    | Topic[Thought]
    | Topic[m.Control]
    | Topic[Journal],
    ...,
] = (OBSERVATION, ACTION, DIRECTIVE, COMMAND, REPLY, EVENT, STATUS, THOUGHT, CONTROL, JOURNAL)
