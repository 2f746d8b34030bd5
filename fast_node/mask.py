"""The safety mask (the paper's "safety-based action executor"): which actions are safe now, and why the others are not.

It reads the state and never the directive. `close_actions` is plain arithmetic on sequences: the node runs it as it is
on lists, and training compiles the same source with numba on arrays, so that there is one mask.

The claims behind each rule are RSS distances (`schemas.measures`) with the named `PRESET` below, matched to what the
simulated traffic and our executor can do; they hold for that traffic, not for a real road.
"""

from __future__ import annotations

import math
from typing import Any

from schemas.measures import CAR_LENGTH_M, gap_m, rss_opposite_m, rss_same_direction_m
from schemas.messages import MetaAction

VERSION = "mask/1"

SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT, BRAKE = (int(a) for a in MetaAction)

RULES = ("", "no lane there", "one change at a time", "lead too close", "speed above the gap's", "front gap in lane",
         "rear gap in lane", "oncoming traffic", "no gap to return to", "nothing to pass", "finish the pass",
         "give up the pass", "lane ends")
(OPEN, NO_LANE, CHANGING, LEAD, SPEED_FOR_GAP, FRONT_GAP, REAR_GAP, ONCOMING, NO_RETURN, NOTHING_TO_PASS, FINISH,
 GIVE_UP, LANE_ENDS) = range(13)

# Preset `sim`: seconds, m/s2. The ego answers within one tick and brakes at 6; simulated cars brake at 6 at most.
REACTION_S = 2.0 / 15.0
EGO_BRAKE = 5.0
LEAD_BRAKE = 6.0
FOLLOWER_REACTION_S = 0.5
FOLLOWER_BRAKE = 3.0
STANDSTILL_M = 2.5
FOLLOW_S = 0.7
FOLLOW_GAIN = 0.5
SIDE_M = 0.3
"""Cars closer than this to overlapping laterally count as in each other's way."""
PASS_ACCEL = 0.7
PASS_FASTER_MPS = 3.0
"""What the ego is sure to manage while passing: this acceleration, up to this much faster than the lead."""
RETURN_S = 2.5
"""To be back in its own lane after the way is clear."""
BEHIND_M = 4.0
"""Room between the passed car and the ego when it returns."""
LEAVE_S = 6.0
"""An oncoming car this close in time ends a stay in its lane as soon as there is room at home."""
SIGHT_M = 190.0
"""Beyond this an oncoming car may exist unseen."""
UNSEEN_ONCOMING_MPS = 8.0


def allowed_speed(gap: float, lead_mps: float) -> float:
    """Highest speed set-point that a gap admits: that of the lead at the following distance, rising with spare room."""
    return max(0.0, lead_mps + FOLLOW_GAIN * (gap - STANDSTILL_M - FOLLOW_S * lead_mps))


def pass_time_s(distance: float, faster_mps: float) -> float:
    """Time to gain `distance` [m] on a car, being `faster_mps` faster now and accelerating as the preset promises."""
    if distance <= 0.0:
        return 0.0
    top = max(PASS_FASTER_MPS, faster_mps)
    ramp_s = (top - faster_mps) / PASS_ACCEL
    ramp_m = faster_mps * ramp_s + 0.5 * PASS_ACCEL * ramp_s * ramp_s
    if ramp_m <= distance:
        return ramp_s + (distance - ramp_m) / top
    return (math.sqrt(faster_mps * faster_mps + 2.0 * PASS_ACCEL * distance) - faster_mps) / PASS_ACCEL


def neighbours(rows: Any, lane: int) -> tuple[int, int, int]:
    """Row indices of the nearest car ahead, car behind, and oncoming car ahead in a lane; -1 where there is none."""
    x = rows[0][1]
    ahead, behind, oncoming = -1, -1, -1
    for i in range(1, len(rows)):
        row = rows[i]
        if row[0] < 0 or int(row[8]) != lane:
            continue
        if row[3] < -0.1:
            if row[1] + CAR_LENGTH_M > x and (oncoming < 0 or row[1] < rows[oncoming][1]):
                oncoming = i
        elif row[1] >= x:
            if ahead < 0 or row[1] < rows[ahead][1]:
                ahead = i
        elif behind < 0 or row[1] > rows[behind][1]:
            behind = i
    return ahead, behind, oncoming


def entry(rows: Any, lanes: Any, lane: int) -> tuple[int, int]:
    """Whether the ego may enter a lane of its own direction now: (rule, row index), rule `OPEN` when it may."""
    x, v, length = rows[0][1], rows[0][3], rows[0][6]
    if x > lanes[lane][2] - 2.0 * v - 10.0 or x < lanes[lane][1]:
        return NO_LANE, -1
    ahead, behind, oncoming = neighbours(rows, lane)
    if ahead >= 0:
        gap = gap_m(x, rows[ahead][1], length, rows[ahead][6])
        need = rss_same_direction_m(v, max(rows[ahead][3], 0.0), REACTION_S, 1.0, EGO_BRAKE, LEAD_BRAKE)
        if gap < need + 1.5:
            return FRONT_GAP, ahead
    if behind >= 0:
        gap = gap_m(rows[behind][1], x, rows[behind][6], length)
        need = rss_same_direction_m(rows[behind][3], v, FOLLOWER_REACTION_S, 1.0, FOLLOWER_BRAKE, EGO_BRAKE)
        if gap < max(need, STANDSTILL_M):
            return REAR_GAP, behind
    if oncoming >= 0:  # a car passing head-on in our own lane
        return ONCOMING, oncoming
    return OPEN, -1


def passing(rows: Any, home: int, away: int) -> tuple[int, int]:
    """Whether the ego can still pass its lead in lane `home` through the oncoming lane `away`: (rule, row index)."""
    x, v, length = rows[0][1], rows[0][3], rows[0][6]
    lead = -1
    after = -1
    for i in range(1, len(rows)):  # a car counts as passed once there is room to return before it
        row = rows[i]
        if row[0] < 0 or int(row[8]) != home or row[3] < -0.1:
            continue
        if row[1] + 0.5 * (row[6] + length) + BEHIND_M > x:
            if lead < 0 or row[1] < rows[lead][1]:
                after = lead
                lead = i
            elif after < 0 or row[1] < rows[after][1]:
                after = i
    if lead < 0:
        return NOTHING_TO_PASS, -1
    lead_v = max(rows[lead][3], 0.0)
    if after >= 0:
        room = gap_m(rows[lead][1], rows[after][1], rows[lead][6], rows[after][6])
        fast = lead_v + PASS_FASTER_MPS
        need = rss_same_direction_m(fast, max(rows[after][3], 0.0), REACTION_S, 1.0, EGO_BRAKE, LEAD_BRAKE)
        if room < length + BEHIND_M + need + 4.0:
            return NO_RETURN, after
    to_gain = rows[lead][1] - x + 0.5 * (rows[lead][6] + length) + BEHIND_M
    time = pass_time_s(to_gain, v - lead_v) + RETURN_S
    driven = to_gain + lead_v * time
    _, _, oncoming = neighbours(rows, away)
    if oncoming >= 0:
        gap = gap_m(x, rows[oncoming][1], length, rows[oncoming][6])
        other = -rows[oncoming][3]
    else:
        gap = SIGHT_M
        other = UNSEEN_ONCOMING_MPS
    if gap < driven + other * time + 5.0:
        return ONCOMING, oncoming
    return OPEN, -1


def close_actions(
    rows: Any, lanes: Any, target_speed: float, target_lane: int, previous_lane: int, rule: Any, vehicle: Any
) -> int:
    """Write the rule that closes each action (`OPEN`: none) and the vehicle's id; return how many actions are open.

    rows: (V, 9) as `ROW_COLUMNS`, ego first, id < 0 for an absent vehicle; lanes: (L, 6) y, start, end, direction,
    width, limit; rule, vehicle: (6,) outputs. EMERGENCY_BRAKE is always open.
    """
    ego = rows[0]
    x, y, v, length = ego[1], ego[2], ego[3], ego[6]
    for a in range(6):
        rule[a] = OPEN
        vehicle[a] = -1
    n_lanes = len(lanes)
    away = lanes[target_lane][3] < 0

    # Lateral: one change at a time; the opposite direction gives a running change up.
    for action in (LEFT, RIGHT):
        aim = target_lane - 1 if action == LEFT else target_lane + 1
        if previous_lane >= 0 and aim != previous_lane:
            rule[action] = CHANGING
        elif aim < 0 or aim >= n_lanes:
            rule[action] = NO_LANE
        elif lanes[aim][3] > 0:
            rule[action], vehicle[action] = entry(rows, lanes, aim)
        else:
            rule[action], vehicle[action] = passing(rows, target_lane, aim)
            if rule[action] == OPEN:
                ahead, _, _ = neighbours(rows, target_lane)
                gap = gap_m(x, rows[ahead][1], length, rows[ahead][6]) if ahead >= 0 else 100.0
                if gap < 3.0 + 1.5 * max(0.0, v - rows[ahead][3]):
                    rule[action], vehicle[action] = LEAD, ahead

    # Longitudinal: every car in our way, in the lane we aim for or beside us while we change.
    ceiling = 1e9
    slower = -1
    for i in range(1, len(rows)):
        row = rows[i]
        if row[0] < 0 or row[1] < x or row[3] < -0.1:
            continue
        overlap = abs(row[2] - y) < 0.5 * (row[7] + ego[7]) + SIDE_M
        if not overlap and int(row[8]) != target_lane:
            continue
        gap = gap_m(x, row[1], length, row[6])
        lead_v = max(row[3], 0.0)
        leaving = int(row[8]) != target_lane
        if overlap and gap < (0.5 if leaving else 1.0) + rss_same_direction_m(
                v, lead_v, REACTION_S, 0.0, EGO_BRAKE + 1.0, LEAD_BRAKE):
            for a in range(5):
                if rule[a] == OPEN and a != SLOW_DOWN and not (a >= LEFT and leaving):
                    rule[a], vehicle[a] = LEAD, i
            rule[SLOW_DOWN], vehicle[SLOW_DOWN] = LEAD, i
        limit = lead_v + (gap - 1.0) / 1.5 if leaving else allowed_speed(gap, lead_v)
        if limit < ceiling:
            ceiling, slower = limit, i
    end = lanes[target_lane][2] - x
    at_end = math.sqrt(EGO_BRAKE * max(end - 10.0, 0.0))  # half the braking power stops the ego 10 m before the end
    if end < 60.0 and at_end < ceiling:
        ceiling, slower = at_end, -1
    because = SPEED_FOR_GAP if slower >= 0 else LANE_ENDS
    if rule[CRUISE] == OPEN and target_speed > ceiling + 0.01:
        rule[CRUISE], vehicle[CRUISE] = because, slower
    if rule[SPEED_UP] == OPEN and target_speed + 1.0 > ceiling:
        rule[SPEED_UP], vehicle[SPEED_UP] = because, slower

    # In the oncoming lane: finish the pass while that is possible, otherwise drop back behind the lead.
    if away and rule[BRAKE] == OPEN:
        home = target_lane + 1
        _, _, oncoming = neighbours(rows, target_lane)
        state, who = passing(rows, home, target_lane)
        if oncoming >= 0 or state != NOTHING_TO_PASS:
            back = rule[RIGHT] == OPEN
            if state in (ONCOMING, NO_RETURN):
                ahead, _, _ = neighbours(rows, home)
                alongside = ahead >= 0 and x + 0.5 * length > rows[ahead][1]
                rule_now = FINISH if alongside or rule[RIGHT] == REAR_GAP else GIVE_UP
                if back:  # behind or ahead of the lead: leave the oncoming lane at once
                    for a in (CRUISE, SPEED_UP, SLOW_DOWN):
                        rule[a], vehicle[a] = rule_now, who
                elif rule_now == GIVE_UP:
                    rule[SPEED_UP], vehicle[SPEED_UP] = GIVE_UP, who
                    if target_speed > 0.5 and v > 0.5:
                        rule[CRUISE], vehicle[CRUISE] = GIVE_UP, who
                else:
                    rule[SLOW_DOWN], vehicle[SLOW_DOWN] = FINISH, who
        if oncoming >= 0:
            gap = gap_m(x, rows[oncoming][1], length, rows[oncoming][6])
            if rule[RIGHT] == OPEN and gap < LEAVE_S * (v - rows[oncoming][3]) + 10.0 and state != OPEN:
                for a in (SLOW_DOWN, CRUISE, SPEED_UP):
                    rule[a], vehicle[a] = ONCOMING, oncoming
        if oncoming >= 0 and rule[RIGHT] != OPEN:
            gap = gap_m(x, rows[oncoming][1], length, rows[oncoming][6])
            need = rss_opposite_m(max(v, 0.0), -rows[oncoming][3], REACTION_S, 0.0, EGO_BRAKE, EGO_BRAKE + 1.0)
            if gap < need + 3.0:
                for a in range(5):
                    if rule[a] == OPEN:
                        rule[a], vehicle[a] = ONCOMING, oncoming
    opened = 0
    for a in range(5):
        if vehicle[a] >= 0:
            vehicle[a] = int(rows[int(vehicle[a])][0])
        if rule[a] == OPEN:
            opened += 1
    return opened + 1
