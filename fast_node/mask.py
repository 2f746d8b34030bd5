"""The safety mask (the paper's "safety-based action executor"): which actions are safe now, and why the others are not.

It reads the state and never the directive. `close_actions` is plain arithmetic on sequences: the node runs it as it is
on lists, and training compiles the same source with numba on arrays, so that there is one mask.

The claims behind each rule are RSS distances (`schemas.driving.measures`) with one of the named `PRESETS`: what the
ego and the others are taken to do. They hold for traffic that does so, not for a real road. As in RSS, a car is in
the ego's way
where it is too close both along the road and sideways; beyond RSS, one that moves sideways is also taken to be in the
lane where it will be after `CUT_IN_S`. A follower is taken to see an ego that brakes with `ego_brake`, which an
emergency brake exceeds.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from schemas.driving.intent import BEHIND_M
from schemas.driving.measures import CAR_LENGTH_M, gap_m, rss_lateral_m, rss_opposite_m, rss_same_direction_m
from schemas.wire.messages import Lane, MetaAction, Reason

VERSION = "mask/7"
"""Of what `close_actions` and `choice` compute; tests hold a digest of what they do to it. A policy learns behind
one version and drives behind no other."""

SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT, BRAKE = (int(a) for a in MetaAction)

RULES = ("", *Reason)
"""By number: the reason that closes an action; the first closes none."""
(
    OPEN,
    NO_LANE,
    CHANGING,
    LEAD,
    SPEED_FOR_GAP,
    FRONT_GAP,
    REAR_GAP,
    ONCOMING,
    NO_RETURN,
    NOTHING_TO_PASS,
    FINISH,
    GIVE_UP,
    LANE_ENDS,
    GIVE_UP_CHANGE,
    NOT_WISHED,
) = range(15)


class Preset(NamedTuple):
    """What is assumed of the ego and of others; s, m, m/s2 (brakes as magnitudes)."""

    reaction_s: float
    """Until the ego brakes."""
    ego_brake: float
    """What the ego is sure to manage."""
    lead_brake: float
    """The most that a car ahead brakes with."""
    standstill_m: float
    follow_s: float
    """Time gap to a leader at which the set-point is the leader's speed."""
    ceiling_reaction_s: float
    ceiling_brake: float
    """The speed that a gap admits leaves the executor time to brake with this, before RSS would need all it has."""
    follower_reaction_s: float
    """Until a car behind brakes for an ego that has come in before it."""
    follower_brake: float
    """What a car behind is sure to manage."""
    courtesy_brake: float
    """What a follower is spared where the change can wait: MOBIL's b_safe, for IDM drivers."""
    side_accel: float
    """The most that a car accelerates sideways within its response time."""
    side_brake: float
    """What a car is sure to brake its motion sideways with."""
    sway_m: float
    """Room that cars beside each other take up without moving sideways: RSS's mu."""


PRESETS = {
    # Our executor answers within one tick and brakes at 6; simulated cars brake at 6 at most.
    "sim": Preset(2.0 / 15.0, 5.0, 6.0, 2.5, 0.7, 0.3, 4.5, 0.8, 6.0, 1.9, 0.2, 2.0, 0.3),
    # For traffic that brakes harder and reacts later than ours.
    "cautious": Preset(0.3, 4.5, 7.0, 3.0, 1.0, 0.4, 4.0, 1.0, 5.0, 1.5, 0.3, 1.5, 0.4),
}
FOLLOW_GAIN = 0.5
FOLLOWER_BLIND_S = 1.0
CREEP_MPS = 5.0
"""A follower reacts when the ego comes into its lane; a slower ego takes up to `FOLLOWER_BLIND_S` longer for that."""
IDM_GAP_M, IDM_TIME_S, IDM_ACCEL, IDM_BRAKE = 5.0, 1.5, 3.0, 5.0
CUT_IN_MPS = 0.3
CUT_IN_S = 2.0
"""A car moving sideways at least this fast counts as being wherever it comes by within this time, too."""
COMES_OUT_M = 150.0
"""This near to the end of its lane a car may come out of it at any time."""
ASKEW = 0.1
"""Sine of the heading from which on a car may take up room in the next lane."""
PASS_ACCEL = 0.7
PASS_FASTER_MPS = 3.0
PASS_FASTER_MAX_MPS = 8.0
PASS_SPEED_SHARE = 0.75
"""What the ego is sure to manage while passing: this acceleration, up to this much faster than the lead, or to this
share of what the limit leaves."""
RETURN_S = 2.5
"""To be back in its own lane after the way is clear."""
LEAVE_S = 6.0
"""An oncoming car this close in time ends a stay in its lane as soon as there is room at home."""
MUST_M = 30.0
"""With this much more, oncoming traffic is near enough that followers at home are spared nothing but a collision."""
UNSEEN_M = 40.0
"""Room to return before a car this near to the end of sight is not known."""
SIGHT_MARGIN_M = 10.0
"""An oncoming car, as fast as its limit, may exist unseen from this much before the end of sight."""
CHANGE_S = 2.0
CHANGE_M = 12.0
"""A change off a lane that ends must begin this long and this far before."""
STOP_M = 20.0
"""Without a change the ego comes to rest this far before the end: from there it can still steer out of the lane."""
END_BRAKE = 1.2
"""Braking for the end of a lane: gently, and so early, for who comes slowly has time to find a gap."""
END_M = 4.0
"""Nothing of the lane is used beyond this before its end: half a car, and what may stand there."""
LEAVE_M = 6.0
"""So much more room is kept to a car ahead in a lane that ends: it may stop there, and then one must get by."""
OUT_M = 2.3
"""Aside from the lane's centre line by this much the ego is out of the way of what stands at its end."""


def lane_table(lanes: tuple[Lane, ...]) -> list[tuple[float, ...]]:
    """(L, 8): y, start, end, direction, width, limit, change_from, is a ramp (0 or 1); as the mask reads them."""
    return [
        (
            b.y_m,
            b.start_m,
            b.end_m,
            float(b.direction),
            b.width_m,
            b.speed_limit_mps,
            b.change_from_m,
            float(b.kind == "ramp"),
        )
        for b in lanes
    ]


def allowed_speed(gap: float, lead_mps: float, p: Preset) -> float:
    """Highest speed set-point that a gap admits: rising from the lead's at the following distance with spare room,
    and never more than what RSS lets the ego brake from."""
    follow = lead_mps + FOLLOW_GAIN * (gap - p.standstill_m - p.follow_s * lead_mps)
    lag = p.ceiling_reaction_s * p.ceiling_brake
    room = max(gap - 2.0, 0.0)
    stop = (
        math.sqrt(lag * lag + 2.0 * p.ceiling_brake * room + p.ceiling_brake / p.lead_brake * lead_mps * lead_mps) - lag
    )
    return max(0.0, min(follow, stop))


def follower_gap(behind_mps: float, ego_mps: float, must: bool, p: Preset) -> float:
    """Gap that a car behind needs when the ego comes in before it: to be able to stop (RSS), and, unless the ego
    `must` leave its lane, not to have to brake harder than the courtesy brake as an IDM driver."""
    reaction_s = p.follower_reaction_s + FOLLOWER_BLIND_S * max(0.0, 1.0 - ego_mps / CREEP_MPS)
    need = rss_same_direction_m(behind_mps, ego_mps, reaction_s, 0.5, p.follower_brake, p.ego_brake)
    if not must:
        closing = behind_mps - ego_mps
        wanted = IDM_GAP_M + behind_mps * IDM_TIME_S + behind_mps * closing / (2.0 * math.sqrt(IDM_ACCEL * IDM_BRAKE))
        need = max(need, wanted * math.sqrt(IDM_ACCEL / p.courtesy_brake))
    return max(need, p.standstill_m + 1.0)


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


def half_width(row: Any) -> float:
    """Half of what a car takes up across the road [m]: more than half its width where it stands askew."""
    return 0.5 * (float(row[7]) * abs(math.cos(row[5])) + float(row[6]) * abs(math.sin(row[5])))


def survey(rows: Any, lanes: Any, near: Any) -> None:
    """Fill near[3 * lane + (0, 1, 2)] with the row of the nearest car ahead, behind, and oncoming ahead; -1: none.

    A car that moves sideways is in the lane it comes to as well, one that stands askew in the lane it reaches into, and
    one that may come out of a lane that ends in the lane to its left.
    """
    n_lanes = len(lanes)
    longest = 0.0
    for k in range(n_lanes):
        longest = max(longest, lanes[k][2])
    for k in range(3 * n_lanes):
        near[k] = -1
    x = rows[0][1]
    for i in range(1, len(rows)):
        row = rows[i]
        if row[0] < 0:
            continue
        lane = int(row[8])
        other = lane
        if row[4] > CUT_IN_MPS:
            other = lane + 1
        elif row[4] < -CUT_IN_MPS:
            other = lane - 1
        if other != lane and (
            other < 0
            or other >= n_lanes
            or row[1] < lanes[other][1]
            or abs(lanes[other][0] - row[2]) - CUT_IN_S * abs(row[4]) > 0.5 * lanes[other][4]
        ):
            other = lane
        if (
            other == lane
            and lane > 0
            and lanes[lane][2] < longest
            and row[1] > lanes[lane][6]
            and (row[1] > lanes[lane][2] - COMES_OUT_M)
        ):
            other = lane - 1
        if other == lane and abs(math.sin(row[5])) > ASKEW:
            half = half_width(row) + 0.5 * rows[0][7]
            for aside in (lane - 1, lane + 1):
                if 0 <= aside < n_lanes and abs(row[2] - lanes[aside][0]) < half:
                    other = aside
        while True:
            k = 3 * lane
            if row[3] < -0.1:
                if row[1] + CAR_LENGTH_M > x and (near[k + 2] < 0 or row[1] < rows[near[k + 2]][1]):
                    near[k + 2] = i
            elif row[1] >= x:
                if near[k] < 0 or row[1] < rows[near[k]][1]:
                    near[k] = i
            elif near[k + 1] < 0 or row[1] > rows[near[k + 1]][1]:
                near[k + 1] = i
            if lane == other:
                break
            lane = other


def entry(rows: Any, lanes: Any, near: Any, lane: int, aim: int, giving_up: bool, p: Preset) -> tuple[int, int]:
    """Whether the ego may enter lane `aim` of its own direction from `lane` now: (rule, row index), `OPEN` if so.

    giving_up: it is still partly there.
    """
    x, v, length = rows[0][1], rows[0][3], rows[0][6]
    if giving_up and int(rows[0][8]) == aim:  # it has not left yet
        return OPEN, -1
    if not giving_up:
        ends = min(lanes[aim][2], lanes[lane][2])
        if x > ends - CHANGE_S * v - CHANGE_M or x < lanes[aim][1] or x < lanes[lane][6] or lanes[aim][7] > 0.0:
            return NO_LANE, -1
    ahead, behind, oncoming = near[3 * aim], near[3 * aim + 1], near[3 * aim + 2]
    if ahead >= 0:
        gap = gap_m(x, rows[ahead][1], length, rows[ahead][6])
        need = rss_same_direction_m(v, max(rows[ahead][3], 0.0), p.reaction_s, 1.0, p.ego_brake, p.lead_brake)
        if gap < need + 1.5:
            return FRONT_GAP, ahead
    if behind >= 0:
        gap = gap_m(rows[behind][1], x, rows[behind][6], length)
        must = lanes[lane][2] < lanes[aim][2]
        if lanes[lane][3] < 0:
            facing = near[3 * lane + 2]
            must = facing >= 0 and rows[facing][1] - x < LEAVE_S * (v - rows[facing][3]) + MUST_M
        if gap < follower_gap(rows[behind][3], v, must, p):
            return REAR_GAP, behind
    if oncoming >= 0:  # a car passing head-on in our own lane
        return ONCOMING, oncoming
    return OPEN, -1


def ahead_of(rows: Any, lane: int, x: float) -> int:
    """Row of the first car of our direction in `lane` beyond `x` [m]; -1 where there is none."""
    found = -1
    for i in range(1, len(rows)):
        row = rows[i]
        if (
            row[0] >= 0
            and int(row[8]) == lane
            and row[3] >= -0.1
            and row[1] > x
            and (found < 0 or row[1] < rows[found][1])
        ):
            found = i
    return found


def passing(rows: Any, lanes: Any, near: Any, home: int, away: int, sight: float, p: Preset) -> tuple[int, int]:
    """Whether the ego can still pass what is ahead in lane `home` through the oncoming lane `away`: (rule, row index).

    Cars too close to each other to return between them are passed together.
    """
    x, v, length = rows[0][1], rows[0][3], rows[0][6]
    lead = ahead_of(rows, home, x - 0.5 * (CAR_LENGTH_M + length) - BEHIND_M)  # passed once there is room to return
    if lead < 0:
        return NOTHING_TO_PASS, -1
    while True:
        lead_v = max(rows[lead][3], 0.0)
        faster = min(max(PASS_FASTER_MPS, PASS_SPEED_SHARE * (lanes[home][5] - lead_v)), PASS_FASTER_MAX_MPS)
        after = ahead_of(rows, home, rows[lead][1])
        if after < 0:
            break
        room = gap_m(rows[lead][1], rows[after][1], rows[lead][6], rows[after][6])
        need = rss_same_direction_m(
            lead_v + faster, max(rows[after][3], 0.0), p.reaction_s, 1.0, p.ego_brake, p.lead_brake
        )
        if room >= length + BEHIND_M + need + 4.0:
            break
        lead = after
    if rows[lead][1] - x > sight - UNSEEN_M:  # who knows what is ahead of it
        return NO_RETURN, lead
    to_gain = rows[lead][1] - x + 0.5 * (rows[lead][6] + length) + BEHIND_M
    time = pass_time_s(to_gain, v - lead_v, faster) + RETURN_S
    driven = to_gain + lead_v * time
    oncoming = near[3 * away + 2]
    if oncoming >= 0:
        gap = gap_m(x, rows[oncoming][1], length, rows[oncoming][6])
        other = -rows[oncoming][3]
    else:
        gap = sight - SIGHT_MARGIN_M
        other = lanes[away][5]
    if gap < driven + other * time + 5.0:
        return ONCOMING, oncoming
    return OPEN, -1


def close_actions(
    rows: Any,
    lanes: Any,
    target_speed: float,
    target_lane: int,
    previous_lane: int,
    sight: float,
    near: Any,
    rule: Any,
    vehicle: Any,
    p: Preset,
) -> int:
    """Write the rule that closes each action (`OPEN`: none) and the vehicle's id; return how many actions are open.

    rows: (V, 9) as `ROW_COLUMNS`, ego first, id < 0 for an absent vehicle; lanes: (L, 8) as `lane_table`; sight [m];
    near: (3 L,) output of `survey`; rule, vehicle: (6,) outputs. EMERGENCY_BRAKE is always open. Vehicle -1
    beside a rule: none that is seen, but the road itself, the change under way, or a car assumed beyond sight.
    """
    ego = rows[0]
    x, y, v, length = ego[1], ego[2], ego[3], ego[6]
    for a in range(6):
        rule[a] = OPEN
        vehicle[a] = -1
    n_lanes = len(lanes)
    away = lanes[target_lane][3] < 0
    survey(rows, lanes, near)

    # Lateral: one change at a time; the opposite direction gives a running change up.
    for action in (LEFT, RIGHT):
        aim = target_lane - 1 if action == LEFT else target_lane + 1
        if previous_lane >= 0 and aim != previous_lane:
            rule[action] = CHANGING
        elif aim < 0 or aim >= n_lanes:
            rule[action] = NO_LANE
        elif lanes[aim][3] > 0:
            rule[action], vehicle[action] = entry(rows, lanes, near, target_lane, aim, previous_lane >= 0, p)
        else:
            rule[action], vehicle[action] = passing(rows, lanes, near, target_lane, aim, sight, p)
            if rule[action] == OPEN:
                ahead = near[3 * target_lane]
                gap = gap_m(x, rows[ahead][1], length, rows[ahead][6]) if ahead >= 0 else 100.0
                if gap < 3.0 + 1.5 * max(0.0, v - rows[ahead][3]):
                    rule[action], vehicle[action] = LEAD, ahead

    # Longitudinal: every car in our way, in the lane we aim for, coming into it, or beside us while we change.
    ceiling = 1e9
    slower = -1
    longest = 0.0
    for k in range(n_lanes):
        longest = max(longest, lanes[k][2])
    must_leave = lanes[target_lane][2] < longest
    lane_y = lanes[target_lane][0]
    back = -1
    if previous_lane >= 0:
        back = LEFT if previous_lane < target_lane else RIGHT
    for i in range(1, len(rows)):
        row = rows[i]
        if row[0] < 0 or row[1] < x or row[3] < -0.1:
            continue
        aside = abs(row[2] - y) - half_width(row) - half_width(ego)
        towards = 1.0 if row[2] > y else -1.0
        overlap = aside < rss_lateral_m(
            towards * ego[4], -towards * row[4], p.reaction_s, p.side_accel, p.side_brake, p.sway_m
        )
        in_lane = int(row[8]) == target_lane
        if not in_lane and row[4] * (lane_y - row[2]) > 0.0 and abs(row[4]) > CUT_IN_MPS:
            in_lane = abs(lane_y - row[2]) - CUT_IN_S * abs(row[4]) < 0.5 * (row[7] + ego[7])
        if not overlap and not in_lane:
            continue
        gap = gap_m(x, row[1], length, row[6])
        lead_v = max(row[3], 0.0)
        leaving = not in_lane
        if overlap and gap < (0.5 if leaving else 1.0) + rss_same_direction_m(
            v, lead_v, p.reaction_s, 0.0, p.ego_brake + 1.0, p.lead_brake
        ):
            # While the two are still apart sideways the change may be given up; leaving a lane may go on, but not back
            # behind who is too close there.
            apart = aside > p.sway_m and previous_lane >= 0 and int(ego[8]) == previous_lane
            for a in range(5):
                if (
                    rule[a] == OPEN
                    and a != SLOW_DOWN
                    and not (a >= LEFT and (leaving or apart) and not (leaving and a == back))
                ):
                    rule[a], vehicle[a] = LEAD, i
            rule[SLOW_DOWN], vehicle[SLOW_DOWN] = LEAD, i
        spare = gap - LEAVE_M if gap > LEAVE_M and must_leave else gap
        limit = lead_v + (gap - 1.0) / 1.5 if leaving else allowed_speed(spare, lead_v, p)
        if limit < ceiling:
            ceiling, slower = limit, i
    end = lanes[target_lane][2] - x
    at_end = math.sqrt(2.0 * END_BRAKE * max(end - STOP_M, 0.0))
    if at_end < ceiling:
        ceiling, slower = at_end, -1
    because = SPEED_FOR_GAP if slower >= 0 else LANE_ENDS
    if rule[CRUISE] == OPEN and target_speed > ceiling + 0.01:
        rule[CRUISE], vehicle[CRUISE] = because, slower
    if rule[SPEED_UP] == OPEN and target_speed + 1.0 > ceiling:
        rule[SPEED_UP], vehicle[SPEED_UP] = because, slower
    stop = v * p.reaction_s + v * v / (2.0 * p.ego_brake)
    must_stop = end < END_M + stop
    if previous_lane >= 0 and lanes[previous_lane][2] < lanes[target_lane][2]:
        # Out of the lane that ends before its end? Else stop there while that is possible. No way back beyond that.
        left = OUT_M - abs(y - lanes[previous_lane][0])
        room = lanes[previous_lane][2] - END_M - x
        late = left > 0.0 and room < max(v * (0.4 + 0.45 * left), 2.2 * left)
        must_stop = must_stop or (late and stop <= room < stop + v / 15.0 + 1.0)
        if rule[back] == OPEN and room < stop + v:
            rule[back] = LANE_ENDS
    if must_stop:
        for a in range(3):
            if rule[a] == OPEN:
                rule[a] = LANE_ENDS

    # A change that a car behind has made unsafe is given up while the ego is still more in the lane that it leaves. One
    # that cannot be given up is finished, and not at a crawl: who is behind there expects the ego to drive on.
    behind = near[3 * target_lane + 1]
    if previous_lane >= 0 and behind >= 0 and lanes[target_lane][3] > 0:
        gap = gap_m(rows[behind][1], x, rows[behind][6], length)
        if rule[back] == OPEN:
            if int(ego[8]) == previous_lane and gap < 1.0 + rss_same_direction_m(
                rows[behind][3], v, p.reaction_s, 0.0, p.follower_brake, p.ego_brake
            ):
                for a in range(3):
                    if rule[a] == OPEN:
                        rule[a], vehicle[a] = GIVE_UP_CHANGE, behind
        elif v < rows[behind][3] and gap < follower_gap(rows[behind][3], v, True, p):
            if rule[CRUISE] == OPEN and rule[SPEED_UP] == OPEN and target_speed < CREEP_MPS:
                rule[CRUISE], vehicle[CRUISE] = REAR_GAP, behind
            if rule[SLOW_DOWN] == OPEN and (rule[CRUISE] == OPEN or rule[SPEED_UP] == OPEN):
                rule[SLOW_DOWN], vehicle[SLOW_DOWN] = REAR_GAP, behind

    # In the oncoming lane: finish the pass while that is possible, otherwise drop back behind the lead.
    if away:
        home = target_lane + 1
        oncoming = near[3 * target_lane + 2]
        state, who = passing(rows, lanes, near, home, target_lane, sight, p)
        if oncoming >= 0 or state != NOTHING_TO_PASS:
            back_open = rule[RIGHT] == OPEN
            if state in (ONCOMING, NO_RETURN):
                ahead = near[3 * home]
                alongside = ahead >= 0 and x + 0.5 * length > rows[ahead][1]
                rule_now = FINISH if alongside or rule[RIGHT] == REAR_GAP else GIVE_UP
                if back_open:  # behind or ahead of the lead: leave the oncoming lane at once
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
            need = rss_opposite_m(max(v, 0.0), -rows[oncoming][3], p.reaction_s, 0.0, p.ego_brake, p.ego_brake + 1.0)
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
