"""Who is ahead, behind and facing the ego in every lane, now and where they are heading.

Assumed beyond RSS: a car that moves sideways out of its lane is in the lane that it comes to as well, and settles
there; one that stands askew is in the lane that it reaches into, and one near the end of a lane that ends in the lane
to its left.
"""

from __future__ import annotations

import math
from typing import Any

from fast_node.mask.vocabulary import AHEAD, BEHIND, FACING
from schemas.driving.measures import CAR_LENGTH_M
from schemas.driving.road import (
    AGAINST_MPS,
    DOUBT_VY,
    HEADING,
    ID,
    LANE,
    LANE_END,
    LANE_OPENS,
    LANE_START,
    LANE_WIDTH,
    LANE_Y,
    LENGTH,
    VX,
    VY,
    WIDTH,
    X,
    Y,
    doubt,
    road_end,
)

CUT_IN_MPS = 0.3
CENTRED_M = 0.1
CUT_IN_S = 2.0
"""A car moving sideways at least this fast counts as being wherever it comes by within this time, too."""
COMES_OUT_M = 150.0
"""This near to the end of its lane a car may come out of it at any time."""
ASKEW = 0.1
"""Sine of the heading from which on a car may take up room in the next lane."""


def moves_aside(row: Any) -> bool:
    """Whether a car moves sideways, beyond doubt."""
    return bool(abs(row[VY]) - doubt(row, DOUBT_VY) > CUT_IN_MPS)


def drifts(row: Any, lanes: Any) -> bool:
    """Whether a car's motion sideways leads out of its lane: it is past the centre line, where the lane is left at all.
    Before that, it is taken to be coming into its lane, or to follow its bend."""
    lane = int(row[LANE])
    past = row[Y] - lanes[lane][LANE_Y]
    out: bool = (
        moves_aside(row) and (past if row[VY] > 0.0 else -past) > -CENTRED_M and row[X] >= lanes[lane][LANE_OPENS]
    )
    return out


def settles_at(row: Any, lanes: Any) -> float:
    """Where a car's motion sideways is taken to end [m]: on the centre line that it comes to next. Without such a
    motion, where it is."""
    lane, y = int(row[LANE]), row[Y]
    if moves_aside(row):
        if drifts(row, lanes):
            lane = lane + 1 if row[VY] > 0.0 else lane - 1
        y = lanes[lane][LANE_Y] if 0 <= lane < len(lanes) else y + CUT_IN_S * row[VY]
    return float(y)


def half_width(row: Any) -> float:
    """Half of what a car takes up across the road [m]: more than half its width where it stands askew."""
    heading = row[HEADING]
    half: float = 0.5 * (row[WIDTH] * abs(math.cos(heading)) + row[LENGTH] * abs(math.sin(heading)))
    return half


def heads_for(row: Any, lanes: Any, end: float, ego_width: float) -> int:
    """The lane beside its own that a car is in as well: by its motion, its heading or the end of its lane. Its own
    where there is none.

    end: of the road [m].
    """
    lane = int(row[LANE])
    other = lane
    if drifts(row, lanes):
        other = lane + 1 if row[VY] > 0.0 else lane - 1
    if other != lane and (
        other < 0
        or other >= len(lanes)
        or row[X] < lanes[other][LANE_START]
        or abs(lanes[other][LANE_Y] - row[Y]) - CUT_IN_S * abs(row[VY]) > 0.5 * lanes[other][LANE_WIDTH]
    ):
        other = lane
    if (
        other == lane
        and lane > 0
        and lanes[lane][LANE_END] < end
        and row[X] > lanes[lane][LANE_OPENS]
        and row[X] > lanes[lane][LANE_END] - COMES_OUT_M
    ):
        other = lane - 1
    if other == lane and abs(math.sin(row[HEADING])) > ASKEW:
        half = half_width(row) + 0.5 * ego_width
        for aside in (lane - 1, lane + 1):
            if 0 <= aside < len(lanes) and abs(row[Y] - lanes[aside][LANE_Y]) < half:
                other = aside
    return other


def survey(rows: Any, lanes: Any, near: Any) -> float:
    """Fill near[3 * lane + (AHEAD, BEHIND, FACING)] with the row index of the nearest such car; -1: none.

    rows: (V, 9), lanes: (L, 8), near: (3 L,) output. Returns where the road ends [m].
    """
    for k in range(len(near)):
        near[k] = -1
    end = road_end(lanes)
    x, width = rows[0][X], rows[0][WIDTH]
    for i in range(1, len(rows)):
        row = rows[i]
        if row[ID] < 0:
            continue
        if row[VX] < AGAINST_MPS:
            if row[X] + CAR_LENGTH_M <= x:
                continue
            place, nearer = FACING, -1.0
        elif row[X] >= x:
            place, nearer = AHEAD, -1.0
        else:
            place, nearer = BEHIND, 1.0
        lane = int(row[LANE])
        other = lane
        if not (
            -CUT_IN_MPS <= row[VY] <= CUT_IN_MPS and -ASKEW <= row[HEADING] <= ASKEW and lanes[lane][LANE_END] >= end
        ):
            other = heads_for(row, lanes, end, width)
        while True:
            k = 3 * lane + place
            if near[k] < 0 or nearer * (row[X] - rows[near[k]][X]) > 0.0:
                near[k] = i
            if lane == other:
                break
            lane = other
    return end
