"""The actuator's check, the last before the car moves: no action that is certain to end badly is carried out.

It is simpler than the fast node's mask, shares nothing with it but the distances of `schemas.driving.measures`, and
keeps less room than the mask does: behind the mask it has nothing to do. Of an action it asks two questions, on the
true positions: is the place free that the ego would change into, and can the ego still stop behind all that is in its
way? A change into a place that is taken is not begun; where the ego could hardly stop any more it brakes as hard as it
can. An emergency brake is never weakened. Acceleration, jerk and sideways speed are the executor's, whose limits no
action exceeds; what answers no observation of this world, or is no number, does not come so far (`sim_node.gate`).

Plain arithmetic on sequences: the simulator runs it as it is, many scenes compile it. SI units; rows as `ROW_COLUMNS`.
"""

from __future__ import annotations

import math
from typing import Any

from schemas.driving.measures import EGO_BRAKE_MAX_MPS2, gap_m, rss_opposite_m, rss_same_direction_m
from schemas.driving.road import AGAINST_MPS, DT_S, HEADING, ID, LANE, LENGTH, VX, VY, WIDTH, X, Y
from schemas.wire.messages import MetaAction

CRUISE, LEFT, RIGHT = int(MetaAction.CRUISE), int(MetaAction.LEFT), int(MetaAction.RIGHT)
EMERGENCY_BRAKE = int(MetaAction.EMERGENCY_BRAKE)

ADMITTED, TAKEN, GAP, ONCOMING, LANE_END = range(5)
REASONS = ("", "the place is taken", "gap too small", "oncoming traffic", "lane ends")
"""By number: why an action is not carried out."""

REACTION_S = 1.5 * DT_S
"""What is not braked for now can be braked for a tick later; braking tick by tick takes half a tick more."""
OTHERS_BRAKE_MPS2 = 9.0
"""The most that a car ahead brakes with."""
FACING_BRAKE_MPS2 = 2.5
"""What an oncoming car is sure to brake with for an ego in its lane."""
FACING_S = 3.0
"""It comes on at its present speed while the ego brakes, for so long at most: a slow one brakes late."""
ROOM_M = 0.5
"""Left when both stand."""
BEHIND_REACTION_S, BEHIND_BRAKE_MPS2, SHOWN_BRAKE_MPS2, BEHIND_M = 0.5, 6.0, 5.0, 2.0
"""A car behind in the lane that is entered: what it takes to react, brakes with, expects of the ego, and has left."""
NOTICE_S = 1.5
"""So long an oncoming car drives on before it brakes for an ego that comes into its lane."""
SLOW_MPS, BLIND_S = 5.0, 1.0
"""An ego slower than this takes so much longer to come in, at most, and is noticed so much later."""
DRIFT_S = 0.5
"""A car that moves sideways is wherever it comes by within this time, too."""
END_M = 4.0
"""Half a car, and half of what may stand at the end of a lane."""
OUT_M, OUT_S, OUT_S_PER_M, OUT_M_PER_M = 2.0, 0.2, 0.4, 2.0
"""So far aside the ego is past what stands there; to get there takes so long, and so much longer or farther for
each metre."""


def check(
    rows: Any, lane_y: Any, lane_end: Any, meta: int, target_lane: int, previous_lane: int
) -> tuple[int, int, int]:
    """What is done instead of action `meta`, or `meta` itself; why (`REASONS`), and the id of the car it is for or -1.

    rows: (V, 9), the ego first, id < 0 where there is no car; lane_y, lane_end: (L,) beside the ego [m].
    """
    aim, why, whom, here = target_lane, ADMITTED, -1, int(rows[0][LANE])
    if meta in (LEFT, RIGHT):
        asked = target_lane + (1 if meta == RIGHT else -1)
        if 0 <= asked < len(lane_y) and (previous_lane < 0 or asked == previous_lane):
            aim = asked
    if aim != target_lane:
        if aim != here:
            why, whom = taken_by(rows, lane_y[aim], BEHIND_REACTION_S)
        if why == ADMITTED:
            why, whom = must_brake(rows, lane_y, lane_end, aim)
        if why != ADMITTED:
            meta, aim = CRUISE, target_lane
    elif previous_lane >= 0 and here == previous_lane and meta != EMERGENCY_BRAKE:
        why, whom = taken_by(rows, lane_y[aim], REACTION_S)
        if why == ADMITTED:
            why, whom = must_brake(rows, lane_y, lane_end, aim)
        if why != ADMITTED and must_brake(rows, lane_y, lane_end, previous_lane)[0] != ADMITTED:
            why, whom = ADMITTED, -1  # it can not stay where it is
        if why != ADMITTED:
            meta, aim = LEFT if previous_lane < target_lane else RIGHT, previous_lane
    brake, who = must_brake(rows, lane_y, lane_end, aim)
    if brake != ADMITTED and meta != EMERGENCY_BRAKE:
        return EMERGENCY_BRAKE, brake, who
    return meta, why, whom


def in_band(row: Any, low: float, high: float) -> bool:
    """Whether a car takes up room between `low` and `high` across the road [m], now or as it drifts."""
    y, half = 1.0 * row[Y], 0.5 * (row[WIDTH] + row[LENGTH] * abs(math.sin(row[HEADING])))
    later = y + DRIFT_S * row[VY]
    return bool(max(y, later) + half > low and min(y, later) - half < high)


def taken_by(rows: Any, y: float, reaction_s: float) -> tuple[int, int]:
    """Whether a car leaves no room to come to the centre line at `y` [m], and which: (`TAKEN` or `ADMITTED`, id).

    reaction_s: of a car behind, from now on."""
    ego = rows[0]
    half, v = 0.5 * ego[WIDTH], max(1.0 * ego[VX], 0.0)
    for i in range(1, len(rows)):
        row = rows[i]
        if row[ID] < 0 or not in_band(row, y - half, y + half):
            continue
        if row[X] >= ego[X]:
            gap = gap_m(1.0 * ego[X], 1.0 * row[X], ego[LENGTH], row[LENGTH])
            need = room_ahead(v, 1.0 * row[VX])
            if row[VX] < AGAINST_MPS:
                need += NOTICE_S * (v - row[VX])
            elif reaction_s == REACTION_S:
                need = 0.0  # under way, the brake is for that
        else:
            gap = gap_m(1.0 * row[X], 1.0 * ego[X], row[LENGTH], ego[LENGTH])
            need = room_behind(1.0 * row[VX], v, reaction_s)
        if gap < need:
            return TAKEN, int(row[ID])
    return ADMITTED, -1


def room_behind(other: float, v: float, reaction_s: float) -> float:
    """The gap [m] from which a car behind, at speed `other`, stops behind an ego at `v` that comes in before it."""
    if other < AGAINST_MPS:  # it has gone by
        return 0.0
    slow_s = BLIND_S * max(0.0, 1.0 - v / SLOW_MPS)
    need = rss_same_direction_m(max(other, 0.0), v, reaction_s + slow_s, 0.0, BEHIND_BRAKE_MPS2, SHOWN_BRAKE_MPS2)
    return max(need, BEHIND_M)


def room_ahead(v: float, other: float) -> float:
    """The gap [m] from which the ego, at `v`, stops behind a car ahead at speed `other`, or before an oncoming one."""
    if other < AGAINST_MPS:
        stop = v * REACTION_S + 0.5 * v * v / EGO_BRAKE_MAX_MPS2
        comes = -other * min(FACING_S, v / EGO_BRAKE_MAX_MPS2)
        need = rss_opposite_m(v, -other, REACTION_S, 0.0, FACING_BRAKE_MPS2, EGO_BRAKE_MAX_MPS2)
        return ROOM_M + max(need, stop + comes)
    return ROOM_M + rss_same_direction_m(v, max(other, 0.0), REACTION_S, 0.0, EGO_BRAKE_MAX_MPS2, OTHERS_BRAKE_MPS2)


def must_brake(rows: Any, lane_y: Any, lane_end: Any, aim: int) -> tuple[int, int]:
    """Why the ego, on its way to lane `aim`, has no more room than it needs to stop, and for which car; `ADMITTED`
    where it has."""
    ego = rows[0]
    x, y, half, v = 1.0 * ego[X], 1.0 * ego[Y], 0.5 * ego[WIDTH], max(1.0 * ego[VX], 0.0)
    low, high = min(y, lane_y[aim]) - half, max(y, lane_y[aim]) + half
    for i in range(1, len(rows)):
        row = rows[i]
        if row[ID] < 0 or row[X] < x or row[VX] > v:
            continue  # behind, or it draws away
        gap, facing = gap_m(x, 1.0 * row[X], ego[LENGTH], row[LENGTH]), row[VX] < AGAINST_MPS
        if gap >= room_ahead(v, 1.0 * row[VX]) or not in_band(row, low, high):
            continue
        out = half + 0.5 * row[WIDTH] - abs(y - row[Y])
        left_behind = facing and not in_band(row, lane_y[aim] - half, lane_y[aim] + half)
        if left_behind and gap > (v - row[VX]) * (OUT_S + OUT_S_PER_M * out):
            continue  # the ego is out of its way before
        return ONCOMING if facing else GAP, int(row[ID])
    stop = v * REACTION_S + 0.5 * v * v / EGO_BRAKE_MAX_MPS2
    for lane in (int(ego[LANE]), aim):
        room, out = lane_end[lane] - END_M - x, OUT_M - abs(y - lane_y[lane])
        passes = out <= 0.0 or room > max(v * (OUT_S + OUT_S_PER_M * out), OUT_M_PER_M * out)
        if room < stop + ROOM_M and not (passes and lane_end[aim] > lane_end[lane]):
            return LANE_END, -1
    return ADMITTED, -1
