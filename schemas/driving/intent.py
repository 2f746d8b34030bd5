"""The intent: what a directive comes down to for the policy, the same in training, evaluation and driving."""

from __future__ import annotations

from typing import Any, NamedTuple

from schemas.driving.road import BEHIND_M as BEHIND_M
from schemas.driving.road import LANE_END, LANE_RAMP, LANE_WAY, LENGTH, NOBODY, VX, X, home_lane, is_car, lane_ends

ANY_LANE = -1
CALM, NORMAL, ASSERTIVE = range(3)
"""How to drive: `Intent.style`."""
STYLES = {"calm": CALM, "normal": NORMAL, "assertive": ASSERTIVE}
"""By the names of `messages.Style`."""
PASS_SIGHT_M = 60.0
"""A lead farther ahead than this many metres (or `PASS_SIGHT_S` of driving) is not overtaken yet."""
PASS_SIGHT_S = 5.0
SPEED_TOLERANCE_MPS = 0.5
"""An intended speed is met within this."""
LANE_ENDS_S, LANE_ENDS_M = 10.0, 50.0
"""A lane ends soon that ends within this time of driving, and this many metres."""


class Intent(NamedTuple):
    """What the policy is conditioned on. The fast node derives it from a directive, training draws it at random."""

    lane: int
    """The lane to be in; `ANY_LANE`: no matter which. With `pass_id`: the lane to pass from, and to return to."""
    speed_mps: float
    headway_s: float
    pass_id: int = NOBODY
    """The car to overtake on a two-way road; see `intended_lane`. The policy gets the lane that follows from it."""
    style: int = NORMAL
    """`CALM`, `NORMAL` or `ASSERTIVE`."""


def ends_soon(lanes: Any, lane: int, x: float, speed: float) -> bool:
    """Whether `lane` ends before the road does, and soon for a car at `x` [m] with `speed` [m/s]; a ramp always."""
    left = lanes[lane][LANE_END] - x
    return lane_ends(lanes, lane) and bool(lanes[lane][LANE_RAMP] > 0.0 or left < LANE_ENDS_S * speed + LANE_ENDS_M)


def unasked_lane(lanes: Any, target_lane: int, previous_lane: int, x: float, speed: float) -> int:
    """The lane to be in where none is wished: `ANY_LANE`, the policy chooses, on a road with a choice.

    It has none, and is to go to (or stay in) its home lane, where that is the only one of our direction that goes on,
    in a borrowed oncoming lane, in a lane that ends soon, and until the change out of one is over.

    lanes: (L, 8) as `lane_table`; target_lane: the one aimed for; previous_lane: the one that a running change left,
    or -1; x [m], speed [m/s]: the ego's. Compiles with numba unchanged.
    """
    home = home_lane(lanes, target_lane)
    if lanes[target_lane][LANE_WAY] < 0 or ends_soon(lanes, target_lane, x, speed):
        return home
    if previous_lane >= 0 and ends_soon(lanes, previous_lane, x, speed):
        return home
    for k in range(len(lanes)):
        if k != home and lanes[k][LANE_WAY] > 0 and not lane_ends(lanes, k):
            return ANY_LANE
    return home


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
