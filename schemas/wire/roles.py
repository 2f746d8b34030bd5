"""Who may say and hear what: the processes of a car, and those who come through its door."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from schemas.wire.topics import (
    ACTION,
    COMMAND,
    CONTROL,
    DIRECTIVE,
    EVENT,
    JOURNAL,
    OBSERVATION,
    REPLY,
    STATUS,
    THOUGHT,
    TOPICS,
    Topic,
)

Topics = tuple[Topic[Any], ...]

NODES: dict[str, Topics] = {
    "sim": (OBSERVATION, EVENT, STATUS),
    "fast": (ACTION, EVENT, STATUS),
    "slow": (DIRECTIVE, REPLY, THOUGHT, JOURNAL, EVENT, STATUS),
    "cockpit": (COMMAND, CONTROL, STATUS),
    "record": (EVENT, STATUS),
    "foxglove": (STATUS,),
    "door": (STATUS,),
    "supervisor": (COMMAND, STATUS),
}
"""What each process of ours may put; it may read everything. The door brings what those behind it may put as well."""

HEARS: dict[str, Topics] = {
    "sim": (ACTION, CONTROL),
    "fast": (OBSERVATION, DIRECTIVE),
    "slow": (OBSERVATION, COMMAND, EVENT),
}
"""What the nodes that others may stand in for subscribe to; whoever stands in for one is told no more."""


@dataclass(frozen=True, kw_only=True)
class Role:
    """What somebody may do who comes through the door."""

    puts: Topics = ()
    reads: Topics = ()


SHOWN: Topics = (OBSERVATION, ACTION, DIRECTIVE, REPLY, EVENT, STATUS)
"""What a passenger may see. Thoughts, journal and the words of others stay inside."""

ROLES: dict[str, Role] = {
    "passenger": Role(puts=(COMMAND,), reads=SHOWN),
    "operator": Role(puts=(COMMAND, CONTROL), reads=(*SHOWN, THOUGHT)),
    "recorder": Role(reads=TOPICS),
    **{name: Role(puts=NODES[name], reads=HEARS[name]) for name in HEARS},
}
"""By the common name of a certificate. Who comes without one, on loopback, is a passenger."""


def own(*topics: Topic[Any]) -> tuple[str, ...]:
    """The keys of topics, with what announces their messages."""
    return tuple(f"{topic.key}/**" for topic in topics)
