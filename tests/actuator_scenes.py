"""Scenes for the actuator's check: an ego at x = 100 m on three lanes of one direction."""

from __future__ import annotations

from typing import Any

from schemas.wire.messages import MetaAction
from sim_node.actuator import check
from tests.scenes import car

LANES, ENDS = [0.0, 4.0, 8.0], [1000.0, 1000.0, 1000.0]
SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT, BRAKE = MetaAction


def asked(
    meta: int, *others: list[float], v: float = 20.0, y: float = 4.0, aim: int = 1, left: int = -1, ends: Any = ENDS
) -> tuple[int, int, int]:
    """What is done, why and for whom."""
    ego = car(0, 100.0, round(y / 4.0), v, y)
    return check([ego, *others], LANES, ends, meta, aim, left)
