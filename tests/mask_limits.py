"""What the mask closes with the preset of round numbers, and how high its speed cap is: for tests of its limits."""

from __future__ import annotations

from typing import Any

from fast_node.mask.vocabulary import REASONS
from schemas.wire.messages import MetaAction
from tests.mask_scenes import HIGHWAY, PLAIN, capped, judge

SLOW_DOWN, CRUISE, SPEED_UP = MetaAction.SLOW_DOWN, MetaAction.CRUISE, MetaAction.SPEED_UP
LEFT, RIGHT = MetaAction.LEFT, MetaAction.RIGHT
ALL = (SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT)
NEAR, GAP, FRONT, REAR = "lead too close", "speed above the gap's", "front gap in lane", "rear gap in lane"
CHANGING, ENDS, GIVE_UP_CHANGE = "one change at a time", "lane ends", "give up the change"
ONCOMING, FINISH, GIVE_UP, NO_LANE = "oncoming traffic", "finish the pass", "give up the pass", "no lane there"

Closed = dict[int, tuple[str, int]]


def closed(*rows: list[float], lanes: Any = HIGHWAY, speed: float = 8.0, lane: int = 1, previous: int = -1) -> Closed:
    """Action to (reason, vehicle)."""
    reasons, vehicle = judge(list(rows), lanes, speed, lane, previous, PLAIN)
    return {a: (REASONS[r], v) for a, (r, v) in enumerate(zip(reasons, vehicle, strict=True)) if REASONS[r]}


def cap(*rows: list[float], lanes: Any = HIGHWAY, speed: float = 8.0, lane: int = 1, previous: int = -1) -> float:
    """The speed cap [m/s]."""
    return capped(list(rows), lanes, speed, lane, previous, PLAIN)[2]


def all_but(*opened: int, by: str, who: int) -> Closed:
    return {int(a): (by, who) for a in ALL if a not in opened}
