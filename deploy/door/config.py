"""The door's configuration."""

from __future__ import annotations

from schemas.runtime.bus_settings import BusConfig
from schemas.runtime.process import NodeConfig
from schemas.wire.topics import TOPICS

_NAMES = {topic.name for topic in TOPICS}


class DoorConfig(NodeConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `python -m deploy.door` takes; `bus` is the inner side."""

    outside: BusConfig
    """Where users come, and what they may."""
    inward: tuple[str, ...] = ("command",)
    """The topics that it carries in, by name."""
    outward: tuple[str, ...] = ()
    """Those that it carries out."""
    stand_ins: tuple[str, ...] = ()
    """Nodes that somebody outside stands in for: an event or a status from there may name these alone."""
    polite: bool = True
    """It takes less of the processor than others; False where a node that drives is behind it."""

    def __post_init__(self) -> None:
        if unknown := sorted({*self.inward, *self.outward} - _NAMES):
            raise ValueError(f"there is no topic {unknown[0]!r}")
