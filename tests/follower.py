"""The coordination followed tick by tick, the mask's closures given by hand: what its tests are made of."""

from __future__ import annotations

from typing import Any, NamedTuple

from fast_node.coordination import Coordination
from schemas.driving.intent import NORMAL
from schemas.driving.road import lane_table
from schemas.runtime.clock import NS
from schemas.wire.codec import rows_of
from schemas.wire.messages import Closure, Directive, Event, EventKind, MetaAction, Observation, Reason
from tests import scenes
from tests.scenes import Row, car, directive, lane

HZ = 15
DEFAULT_HEADWAY_S = 1.5
TWO_WAY = (lane(0, oncoming=True, limit_mps=9.0), lane(1, limit_mps=8.0))
HIGHWAY = tuple(lane(k, limit_mps=25.0 + k) for k in range(4))
OVERTAKE = directive(manoeuvre="overtake", target_speed_mps=8.0)
LEAD, PASSED = car(1, 514, 1, 4), car(1, 490, 1, 4)
"""The car to pass, before and after."""


class Told(NamedTuple):
    """An event, in short."""

    kind: EventKind
    reason: Reason | None
    vehicle: int
    since: int
    seconds: float


class Seen(NamedTuple):
    """The intent at a tick, and what is reported."""

    lane: int
    speed: float
    headway: float
    told: list[Told]

    @property
    def kinds(self) -> list[EventKind]:
        return [told.kind for told in self.told]


def in_short(event: Event) -> Told:
    return Told(event.kind, event.reason, event.vehicle, event.since_tick, event.duration_s)


def observation(tick: int, *cars: Row, lane: int = 1, speed: float = 5.0, **fields: Any) -> Observation:
    """On the two-way road, the ego at x 500 and its set-point 5 m/s."""
    return scenes.observation(
        car(0, 500, lane, speed), *cars, **{"tick": tick, "lanes": TWO_WAY, "target_speed_mps": 5.0, **fields}
    )


class Follower:
    """Coordination, tick by tick: what the node asks of it and tells it."""

    def __init__(self) -> None:
        self.coordination = Coordination(DEFAULT_HEADWAY_S)
        self.events: list[Event] = []
        self.style = NORMAL
        """Of the newest intent."""

    def at(
        self,
        seen: Observation,
        follows: Directive | None = None,
        closed: dict[MetaAction, Closure] | None = None,
        does: MetaAction = MetaAction.CRUISE,
        now_s: float | None = None,
    ) -> Seen:
        """A tick: what is seen and told, what the mask closes, what the ego does. now_s: by default the tick's."""
        now_ns = round((seen.tick / HZ if now_s is None else now_s) * NS)
        rows, lanes = rows_of(seen).tolist(), lane_table(seen.lanes)
        intent, events = self.coordination.intent(seen, rows, lanes, follows, now_ns)
        events += self.coordination.report(seen, intent, tuple((closed or {}).values()), does)
        self.events += events
        self.style = intent.style
        return Seen(intent.lane, intent.speed_mps, intent.headway_s, [in_short(event) for event in events])


def shut(*actions: MetaAction, by: Reason, vehicle: int = -1) -> dict[MetaAction, Closure]:
    """What the mask closes."""
    return {action: Closure(action=int(action), reason=by, vehicle=vehicle) for action in actions}
