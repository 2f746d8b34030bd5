"""The intent: what a directive comes down to for the policy, the same in training, evaluation and driving."""

from __future__ import annotations

from typing import Any, NamedTuple

from schemas.driving.road import BEHIND_M as BEHIND_M
from schemas.driving.road import LENGTH, NOBODY, VX, X, is_car

ANY_LANE = -1
PASS_SIGHT_M = 60.0
"""A lead farther ahead than this many metres (or `PASS_SIGHT_S` of driving) is not overtaken yet."""
PASS_SIGHT_S = 5.0
SPEED_TOLERANCE_MPS = 0.5
"""An intended speed is met within this."""


class Intent(NamedTuple):
    """What the policy is conditioned on. The fast node derives it from a directive, training draws it at random."""

    lane: int
    """The lane to be in; `ANY_LANE`: no matter which. With `pass_id`: the lane to pass from, and to return to."""
    speed_mps: float
    headway_s: float
    pass_id: int = NOBODY
    """The car to overtake on a two-way road; see `intended_lane`. The policy gets the lane that follows from it."""


def intended_lane(rows: Any, home: int, pass_id: int) -> int:
    """The lane to be in while overtaking the car `pass_id` from lane `home`: beside it until it is passed, then home.

    rows: (V, 9) sequence as `ROW_COLUMNS`, or tracks: of a car that is missed for long its motion is remembered, and
    it is not passed before that says so. Compiles with numba unchanged.
    """
    if pass_id < 0:
        return home
    ego = rows[0]
    for i in range(1, len(rows)):
        row = rows[i]
        if is_car(row, pass_id):
            ahead = row[X] + 0.5 * (row[LENGTH] + ego[LENGTH]) + BEHIND_M - ego[X]
            if 0.0 < ahead < max(PASS_SIGHT_M, PASS_SIGHT_S * ego[VX]):
                return home - 1
    return home
