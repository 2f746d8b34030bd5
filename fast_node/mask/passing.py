"""Claim: a pass through the oncoming lane is over before anybody who comes can be met, or it is given up in time.

RSS Definition 2 (opposite directions) for the last moment. Assumed: the ego gains on the lead as `pass_time_s` has it,
oncoming traffic that is not seen yet may come at its limit from just beyond the end of sight, and it does not speed up.
Cars too close to each other to return between them are passed together. Every car counts as `CAR_LENGTH_M` long for
what "passed" means here.
"""

from __future__ import annotations

import math
from typing import Any

from fast_node.mask.entering import LEAVE_S, room
from fast_node.mask.vocabulary import (
    AHEAD,
    CRUISE,
    FACING,
    FINISH,
    GIVE_UP,
    LEAD,
    NO_RETURN,
    NOTHING_TO_PASS,
    ONCOMING,
    OPEN,
    REAR_GAP,
    RIGHT,
    SLOW_DOWN,
    SPEED_UP,
    SPEEDS,
    Situation,
    close,
    close_again,
)
from schemas.driving.measures import CAR_LENGTH_M, rss_opposite_m, rss_same_direction_m
from schemas.driving.road import (
    BEHIND_M,
    DOUBT_VX,
    DOUBT_X,
    LANE_LIMIT,
    LANE_WAY,
    LENGTH,
    VX,
    X,
    doubt,
    gap_between,
    next_ahead,
)
from schemas.wire.messages import POLICY_ACTIONS

PASS_ACCEL = 0.7
PASS_FASTER_MPS = 3.0
PASS_FASTER_MAX_MPS = 8.0
PASS_SPEED_SHARE = 0.75
"""What the ego is sure to manage while passing: this acceleration, up to this much faster than the lead, or to this
share of what the limit leaves."""
RETURN_S = 2.5
"""To be back in its own lane after the way is clear."""
UNSEEN_M = 40.0
"""Room to return before a car this near to the end of sight is not known."""
SIGHT_MARGIN_M = 10.0
"""An oncoming car, as fast as its limit, may exist unseen from this much before the end of sight."""


def pass_time_s(distance: float, faster_mps: float, top_mps: float) -> float:
    """Time to gain `distance` [m] on a car, being `faster_mps` faster now and accelerating as the preset promises."""
    if distance <= 0.0:
        return 0.0
    top = max(top_mps, faster_mps)
    ramp_s = (top - faster_mps) / PASS_ACCEL
    ramp_m = faster_mps * ramp_s + 0.5 * PASS_ACCEL * ramp_s * ramp_s
    if ramp_m <= distance:
        return ramp_s + (distance - ramp_m) / top
    return (math.sqrt(faster_mps * faster_mps + 2.0 * PASS_ACCEL * distance) - faster_mps) / PASS_ACCEL


def passing(s: Situation, home: int, away: int, share: float = 1.0) -> tuple[int, int]:
    """Whether the ego can still pass what is ahead in lane `home` through the oncoming lane `away`: (reason, row).

    share: of the doubt about others that counts. All of it where a pass begins; none where it goes on, or what is
    learnt about a car on the way would end a pass that was begun with room to spare.
    """
    rows, lanes, p, ego = s.rows, s.lanes, s.preset, s.rows[0]
    x, v, length = ego[X], ego[VX], ego[LENGTH]
    lead = next_ahead(rows, home, x - 0.5 * (CAR_LENGTH_M + length) - BEHIND_M)  # passed once there is room to return
    if lead < 0:
        return NOTHING_TO_PASS, -1
    while True:
        lead_v = max(rows[lead][VX] + share * doubt(rows[lead], DOUBT_VX), 0.0)
        faster = min(max(PASS_FASTER_MPS, PASS_SPEED_SHARE * (lanes[home][LANE_LIMIT] - lead_v)), PASS_FASTER_MAX_MPS)
        after = next_ahead(rows, home, rows[lead][X])
        if after < 0:
            break
        slowest = max(rows[after][VX] - share * doubt(rows[after], DOUBT_VX), 0.0)
        need = rss_same_direction_m(lead_v + faster, slowest, p.reaction_s, 1.0, p.ego_brake, p.lead_brake)
        if gap_between(rows[lead], rows[after]) >= length + BEHIND_M + need + 4.0:
            break
        lead = after
    if rows[lead][X] - x > s.sight - UNSEEN_M:  # what is ahead of it is not known
        return NO_RETURN, lead
    to_gain = rows[lead][X] - x + 0.5 * (rows[lead][LENGTH] + length) + BEHIND_M + share * doubt(rows[lead], DOUBT_X)
    time = pass_time_s(to_gain, v - lead_v, faster) + RETURN_S
    driven = to_gain + lead_v * time
    facing = s.near[3 * away + FACING]
    if facing >= 0:
        gap, other = nearest_facing(s, facing, away, share)
    else:
        gap, other = s.sight - SIGHT_MARGIN_M, lanes[away][LANE_LIMIT]
    if gap < driven + other * time + 5.0:
        return ONCOMING, facing
    return OPEN, -1


def nearest_facing(s: Situation, facing: int, away: int, share: float) -> tuple[float, float]:
    """Gap [m] and speed [m/s] of the oncoming car of row `facing` in lane `away`, at worst by a `share` of the doubt.
    Where its speed is in doubt it is no more than the limit, which is what cars beyond sight are taken to drive."""
    row = s.rows[facing]
    speed, unsure = -row[VX], share * doubt(row, DOUBT_VX)
    if unsure > 0.0:
        speed = max(speed, min(speed + unsure, s.lanes[away][LANE_LIMIT]))
    return gap_between(s.rows[0], row) - share * doubt(row, DOUBT_X), speed


def start_pass(s: Situation, aim: int) -> tuple[int, int]:
    """Whether the ego may pull out into the oncoming lane `aim` now: (reason, row index), `OPEN` if so."""
    reason, who = passing(s, s.lane, aim)
    if reason != OPEN:
        return reason, who
    ego, ahead = s.rows[0], s.near[3 * s.lane + AHEAD]
    if ahead >= 0:
        other = s.rows[ahead]
        closing = max(0.0, ego[VX] - other[VX] + doubt(other, DOUBT_VX))
        if gap_between(ego, other) - doubt(other, DOUBT_X) < 3.0 + 1.5 * closing:
            return LEAD, ahead
    return room(s, aim)  # who stands there, or passes the ego, does not face it


def settle_pass(s: Situation, reasons: Any, vehicle: Any) -> None:
    """In the oncoming lane: finish the pass while that is possible, otherwise drop back behind the lead, and in either
    case leave the lane, or stop, before an oncoming car is met."""
    if s.lanes[s.lane][LANE_WAY] > 0:
        return
    ego, home, facing = s.rows[0], s.lane + 1, s.near[3 * s.lane + FACING]
    state, who = passing(s, home, s.lane, 0.0)
    if state in (ONCOMING, NO_RETURN):
        _finish_or_give_up(s, home, who, reasons, vehicle)
    if facing < 0:
        return
    gap, other = nearest_facing(s, facing, s.lane, 1.0)
    if reasons[RIGHT] == OPEN:
        if gap < LEAVE_S * (ego[VX] + other) + 10.0 and state != OPEN:
            for a in SPEEDS:
                close_again(reasons, vehicle, a, ONCOMING, facing)
    else:
        p = s.preset
        need = rss_opposite_m(max(ego[VX], 0.0), other, p.reaction_s, 0.0, p.follower_brake, p.ego_brake)
        if gap < need + 3.0:
            for a in range(POLICY_ACTIONS):
                close(reasons, vehicle, a, ONCOMING, facing)


def _finish_or_give_up(s: Situation, home: int, who: int, reasons: Any, vehicle: Any) -> None:
    """There is no time left to pass what is ahead: whoever is alongside it goes on, whoever is behind it falls back."""
    ego, ahead = s.rows[0], s.near[3 * home + AHEAD]
    alongside = ahead >= 0 and ego[X] + 0.5 * ego[LENGTH] > s.rows[ahead][X]
    reason = FINISH if alongside or reasons[RIGHT] == REAR_GAP else GIVE_UP
    if reasons[RIGHT] == OPEN:  # behind or ahead of the lead: leave the oncoming lane at once
        for a in SPEEDS:
            close_again(reasons, vehicle, a, reason, who)
    elif reason == GIVE_UP:
        close_again(reasons, vehicle, SPEED_UP, GIVE_UP, who)
        if s.target_speed > 0.5 and ego[VX] > 0.5:
            close_again(reasons, vehicle, CRUISE, GIVE_UP, who)
    else:
        close_again(reasons, vehicle, SLOW_DOWN, FINISH, who)
