"""One picture of the road: what the columns mean, who is a car's neighbour, which lane is home, what has been passed.

Mask, choice, coordination, features, scene and metrics read vehicles and lanes through the names in here, so that each
word means one thing everywhere. Plain arithmetic on sequences: the nodes run it as it is on lists, and training
compiles the same source with numba on arrays.

Axes: V vehicles (the ego first), L lanes (0 is the leftmost). SI units; x along the ego's direction, y to the right.
"""

from __future__ import annotations

from typing import Any

from schemas.driving.measures import gap_m
from schemas.wire.messages import ROW_COLUMNS, Lane

HZ = 15
"""Ticks per second: the rate of the simulator, of the contract's deadlines and of the trained weights."""
DT_S = 1.0 / HZ
DECISION_TICKS = 5
"""From one decision to the next: a policy learns and drives at three a second."""

ID, X, Y, VX, VY, HEADING, LENGTH, WIDTH, LANE = range(len(ROW_COLUMNS))
"""Columns of a vehicle's row: `messages.ROW_COLUMNS`. ID is negative where there is no vehicle."""
DOUBT_X, DOUBT_Y, DOUBT_VX, DOUBT_VY = range(LANE + 1, LANE + 5)
"""Columns that a track adds (`tracks`): how far off the truth may be. A bare row has none, and none in doubt."""

LANE_Y, LANE_START, LANE_END, LANE_WAY, LANE_WIDTH, LANE_LIMIT, LANE_OPENS, LANE_RAMP = range(8)
"""Columns of `lane_table`. WAY: +1 with the ego, -1 oncoming; OPENS: where changes out of it begin; RAMP: 1 on one."""

AGAINST_MPS = -0.1
"""A vehicle whose VX is below this drives against the ego's direction."""
BEHIND_M = 4.0
"""A vehicle is passed once this much room lies between its front and the ego's rear: enough to move in before it."""
NOBODY = -1
"""The row index, and the id, of a vehicle that is not there."""


def lane_table(lanes: tuple[Lane, ...]) -> list[tuple[float, ...]]:
    """(L, 8) in the columns above; the form in which mask and training read `Observation.lanes`."""
    return [
        (
            lane.y_m,
            lane.start_m,
            lane.end_m,
            float(lane.direction),
            lane.width_m,
            lane.speed_limit_mps,
            lane.change_from_m,
            float(lane.kind == "ramp"),
        )
        for lane in lanes
    ]


def doubt(row: Any, column: int) -> float:
    """How far off the truth a track's `column` (`DOUBT_X`, ...) may be; 0 for a bare row."""
    return float(row[column]) if len(row) > column else 0.0


def is_car(row: Any, number: int) -> bool:
    """Whether a row is the car `number`'s, be it seen or only remembered (its ID is then -2 - number)."""
    return bool(row[ID] == number or row[ID] == -2 - number)


def is_oncoming(row: Any) -> bool:
    """Whether a vehicle drives against the ego's direction."""
    return bool(row[VX] < AGAINST_MPS)


def gap_between(rear: Any, front: Any) -> float:
    """Bumper-to-bumper distance [m] between the rows of two vehicles; negative where they overlap along the road."""
    return gap_m(rear[X], front[X], rear[LENGTH], front[LENGTH])


def next_ahead(rows: Any, lane: int, x: float) -> int:
    """Row index of the first vehicle of our direction in `lane` whose centre lies beyond `x` [m]; NOBODY if none."""
    found = NOBODY
    for i in range(1, len(rows)):
        row = rows[i]
        if (
            row[ID] >= 0
            and int(row[LANE]) == lane
            and not row[VX] < AGAINST_MPS
            and row[X] > x
            and (found < 0 or row[X] < rows[found][X])
        ):
            found = i
    return found


def next_facing(rows: Any, lane: int, x: float) -> int:
    """Row index of the first vehicle that drives against us in `lane`, centre beyond `x` [m]; NOBODY if none."""
    found = NOBODY
    for i in range(1, len(rows)):
        row = rows[i]
        if (
            row[ID] >= 0
            and int(row[LANE]) == lane
            and row[VX] < AGAINST_MPS
            and row[X] > x
            and (found < 0 or row[X] < rows[found][X])
        ):
            found = i
    return found


def lead_id(rows: Any, lane: int) -> int:
    """Id of the next vehicle ahead of the ego in `lane` that drives our way; NOBODY where there is none."""
    lead = next_ahead(rows, lane, rows[0][X])
    return NOBODY if lead < 0 else int(rows[lead][ID])


def has_passed(ego: Any, other: Any) -> bool:
    """Whether the ego has passed `other`, with room to move in before it (`BEHIND_M`)."""
    return bool(gap_m(other[X], ego[X], other[LENGTH], ego[LENGTH]) >= BEHIND_M)


def road_end(lanes: Any) -> float:
    """Where the road ends [m]: the farthest end of any lane. lanes: (L, 8)."""
    end = lanes[0][LANE_END]
    for k in range(1, len(lanes)):
        end = max(end, lanes[k][LANE_END])
    return float(end)


def lane_ends(lanes: Any, lane: int) -> bool:
    """Whether `lane` ends before the road does: a ramp, or a lane closed by roadworks. lanes: (L, 8)."""
    return bool(lanes[lane][LANE_END] < road_end(lanes))


def home_lane(lanes: Any, lane: int) -> int:
    """The lane to go on in for who is in (or aims for) `lane`. lanes: (L, 8).

    From a borrowed oncoming lane: the first to the right of our own direction. From a lane that ends: the nearest to
    the left of our direction that does not. Otherwise the lane itself.
    """
    while lanes[lane][LANE_WAY] < 0 and lane + 1 < len(lanes):
        lane += 1
    while lane > 0 and lane_ends(lanes, lane) and lanes[lane - 1][LANE_WAY] > 0:
        lane -= 1
    return lane
