"""Claim: the ego can always stop behind every car ahead that is, or comes, in its way.

RSS safe distances (Shalev-Shwartz et al. 2017): along the road Definition 1, sideways Definition 6. As in RSS a car is
in the way where it is too close both along the road and sideways. Assumed: the ego brakes with `ego_brake` after
`reaction_s`, a lead with at most `lead_brake`, and both keep their sideways acceleration within `side_accel` and
`side_brake`; a car that crosses into the ego's lane within `CUT_IN_S` is in it already; one that has come in nearer
than that, but is faster than the ego, is taken to pull away.
"""

from __future__ import annotations

import math
from typing import Any

from fast_node.mask.neighbours import CUT_IN_S, drifts, half_width, settles_at
from fast_node.mask.vocabulary import (
    CRUISE,
    LEAD,
    LEFT,
    OPEN,
    SLOW_DOWN,
    SPEED_UP,
    Preset,
    Situation,
    back_action,
    close,
    close_again,
)
from schemas.driving.measures import INF, SPEED_STEP_MPS, gap_m, rss_lateral_m, rss_same_direction_m
from schemas.driving.road import (
    AGAINST_MPS,
    DOUBT_VX,
    DOUBT_VY,
    DOUBT_X,
    DOUBT_Y,
    ID,
    LANE,
    LANE_END,
    LANE_Y,
    LENGTH,
    VX,
    VY,
    WIDTH,
    X,
    Y,
    doubt,
)
from schemas.wire.messages import POLICY_ACTIONS

FOLLOW_GAIN = 0.5
LIKELY = 0.4
"""Share of a doubt that counts for what is done at once, an emergency brake at worst: a standard deviation. The speed
cap takes the whole doubt, and so brakes for it earlier, and gently."""
FIRM_MPS = 5.0
"""The executor brakes with its gain times this much below its speed."""
LEAVE_M = 6.0
"""So much more room is kept to a car ahead in a lane that ends: it may stop there, and then one must get by."""


def allowed_speed(gap: float, lead_mps: float, p: Preset) -> float:
    """Highest speed set-point that a gap admits: rising from the lead's at the following distance with spare room,
    and never more than what RSS lets the ego brake from."""
    follow = lead_mps + FOLLOW_GAIN * (gap - p.standstill_m - p.follow_s * lead_mps)
    return max(0.0, min(follow, stopping_speed(gap, lead_mps, p)))


def stopping_speed(gap: float, lead_mps: float, p: Preset) -> float:
    """The set-point from which RSS lets the ego brake, after the executor's lag, behind a lead `gap` [m] ahead."""
    lag = p.ceiling_reaction_s * p.ceiling_brake
    room = max(gap - 2.0, 0.0)
    return (
        math.sqrt(lag * lag + 2.0 * p.ceiling_brake * room + p.ceiling_brake / p.lead_brake * lead_mps * lead_mps) - lag
    )


def aside_m(ego: Any, row: Any, lanes: Any) -> float:
    """Distance [m] between the ego and another car, side to side, now or where the other's motion sideways ends:
    whichever is less; negative where they overlap across the road."""
    apart: float = min(abs(row[Y] - ego[Y]), abs(settles_at(row, lanes) - ego[Y])) - half_width(row) - half_width(ego)
    return apart


def side_gap(ego: Any, row: Any, p: Preset) -> float:
    """Distance [m], side to side, from which the ego and another car can both stay apart (RSS Definition 6). Where the
    other's own motion ends `aside_m` knows."""
    towards = 1.0 if row[Y] > ego[Y] else -1.0
    return LIKELY * doubt(row, DOUBT_Y) + rss_lateral_m(
        towards * ego[VY], LIKELY * doubt(row, DOUBT_VY), p.reaction_s, p.side_accel, p.side_brake, p.sway_m
    )


def keep_gaps(s: Situation, reasons: Any, vehicle: Any) -> tuple[float, int]:
    """Close what the cars ahead make unsafe at once; return the highest speed [m/s] that they admit (inf: any), and the
    row of the car that it is for (-1: none)."""
    p, ego = s.preset, s.rows[0]
    x, v, lane_y = ego[X], ego[VX], s.lanes[s.lane][LANE_Y]
    lane_ends = s.lanes[s.lane][LANE_END] < s.road_end
    ceiling, slower = INF, -1
    for i in range(1, len(s.rows)):
        row = s.rows[i]
        if row[ID] < 0 or row[X] < x or row[VX] < AGAINST_MPS:
            continue
        leaving = int(row[LANE]) != s.lane
        if abs(int(row[LANE]) - s.lane) == 1 and row[VY] * (lane_y - row[Y]) > 0.0 and drifts(row, s.lanes):
            leaving = abs(lane_y - row[Y]) - CUT_IN_S * abs(row[VY]) >= 0.5 * (row[WIDTH] + ego[WIDTH])
        gap, lead_v = gap_m(x, row[X], ego[LENGTH], row[LENGTH]), max(row[VX], 0.0)
        unsure, slowest = doubt(row, DOUBT_X), max(row[VX] - doubt(row, DOUBT_VX), 0.0)
        likely = max(row[VX] - LIKELY * doubt(row, DOUBT_VX), 0.0)
        need = rss_same_direction_m(v, likely, p.reaction_s, 0.0, p.ego_brake + 1.0, p.lead_brake)
        too_near = gap - LIKELY * unsure < (0.5 if leaving else 1.0) + need
        spare = gap - LEAVE_M if gap > LEAVE_M and lane_ends else gap
        limit = lead_v + (gap - 1.0) / 1.5 if leaving else allowed_speed(spare, lead_v, p)
        if not leaving:  # what is comfortable follows the best guess; what is safe, the worst
            limit = min(limit, max(stopping_speed(spare - unsure, slowest, p), 0.0))
        if (not too_near and limit >= ceiling) or (leaving and aside_m(ego, row, s.lanes) >= side_gap(ego, row, p)):
            continue
        if too_near:
            keep_clear(s, i, leaving, reasons, vehicle)
        if limit < ceiling:
            ceiling, slower = limit, i
    return ceiling, slower


def keep_clear(s: Situation, i: int, leaving: bool, reasons: Any, vehicle: Any) -> None:
    """Close what leads nearer to the car of row `i`, which is too near along the road, if it is so sideways, too.

    leaving: it is only in the way as long as the ego has not left the lane.
    """
    ego, row, p = s.rows[0], s.rows[i], s.preset
    aside, enters = aside_m(ego, row, s.lanes), s.previous >= 0 and not leaving
    if aside >= side_gap(ego, row, p) and not enters:  # who comes in behind it is not apart from it for long
        return
    # While the two are still apart sideways the change may be given up; leaving a lane may go on, but not back behind
    # a car that is too close there.
    back, apart = back_action(s), aside > p.sway_m and s.previous >= 0 and int(ego[LANE]) == s.previous
    for a in range(POLICY_ACTIONS):
        if a != SLOW_DOWN and not (a >= LEFT and (leaving or apart) and not (leaving and a == back)):
            close(reasons, vehicle, a, LEAD, i)
    if row[VX] <= ego[VX] or enters:  # no emergency brake for a car that has come in and is pulling away
        close_again(reasons, vehicle, SLOW_DOWN, LEAD, i)


def keep_below(s: Situation, cap: float, reason: int, who: int, reasons: Any, vehicle: Any) -> None:
    """Close raising a set-point that is at the speed `cap` [m/s] already, for `reason` and row `who`. The cap itself
    holds whatever the set-point is."""
    if reasons[SPEED_UP] == OPEN and s.target_speed + SPEED_STEP_MPS > cap:
        reasons[SPEED_UP], vehicle[SPEED_UP] = reason, who


def slow_firmly(s: Situation, cap: float, reasons: Any) -> float:
    """The speed cap [m/s], lower where nothing but slowing down is left: a step of the set-point is too little."""
    only_slower = reasons[SLOW_DOWN] == OPEN and reasons[CRUISE] != OPEN and reasons[SPEED_UP] != OPEN
    return min(cap, max(s.rows[0][VX] - FIRM_MPS, 0.0)) if only_slower else cap
