"""Claim: whoever is in a lane that the ego enters can go on: the ego can stop behind the car ahead there, and the car
behind can stop, or need hardly brake, for the ego.

RSS Definition 1 to both. Assumed: a follower reacts `follower_reaction_s` after the ego comes in, later for one at
walking pace, then brakes with `follower_brake`, and takes the ego to brake with `shown_brake` at most (an emergency
brake exceeds that). Where the change can wait, it is spared more than `courtesy_brake` as an IDM driver (MOBIL's
b_safe).
"""

from __future__ import annotations

import math

from fast_node.mask.vocabulary import (
    AHEAD,
    BEHIND,
    FACING,
    FRONT_GAP,
    NO_LANE,
    ONCOMING,
    OPEN,
    REAR_GAP,
    Preset,
    Situation,
)
from schemas.driving.measures import gap_m, rss_same_direction_m
from schemas.driving.road import (
    DOUBT_VX,
    DOUBT_X,
    LANE,
    LANE_END,
    LANE_OPENS,
    LANE_RAMP,
    LANE_START,
    LANE_WAY,
    LENGTH,
    VX,
    X,
    doubt,
)

FOLLOWER_BLIND_S = 1.0
CREEP_MPS = 5.0
"""A follower reacts when the ego comes into its lane; a slower ego takes up to `FOLLOWER_BLIND_S` longer for that."""
IDM_GAP_M, IDM_TIME_S, IDM_ACCEL, IDM_BRAKE = 5.0, 1.5, 3.0, 5.0
LEAVE_S = 6.0
"""An oncoming car this close in time ends a stay in its lane as soon as there is room at home."""
MUST_M = 30.0
"""With this much more, oncoming traffic is near enough that followers at home are spared nothing but a collision."""
CHANGE_S = 2.0
CHANGE_M = 12.0
"""A change off a lane that ends must begin this long and this far before."""


def follower_gap(behind_mps: float, ego_mps: float, must: bool, p: Preset) -> float:
    """Gap [m] that a car behind needs when the ego comes in before it: to be able to stop (RSS), and, unless the ego
    `must` leave its lane, not to have to brake harder than the courtesy brake as an IDM driver."""
    reaction_s = p.follower_reaction_s + FOLLOWER_BLIND_S * max(0.0, 1.0 - ego_mps / CREEP_MPS)
    need = rss_same_direction_m(behind_mps, ego_mps, reaction_s, 0.5, p.follower_brake, p.shown_brake)
    if not must:
        closing = behind_mps - ego_mps
        wanted = IDM_GAP_M + behind_mps * IDM_TIME_S + behind_mps * closing / (2.0 * math.sqrt(IDM_ACCEL * IDM_BRAKE))
        need = max(need, wanted * math.sqrt(IDM_ACCEL / p.courtesy_brake))
    return max(need, p.standstill_m + 1.0)


def must_leave(s: Situation, aim: int) -> bool:
    """Whether the change to lane `aim` cannot wait: the own lane ends before that one, or, borrowed, an oncoming car is
    near."""
    if s.lanes[s.lane][LANE_WAY] < 0:
        facing, ego = s.near[3 * s.lane + FACING], s.rows[0]
        return bool(facing >= 0 and s.rows[facing][X] - ego[X] < LEAVE_S * (ego[VX] - s.rows[facing][VX]) + MUST_M)
    return bool(s.lanes[s.lane][LANE_END] < s.lanes[aim][LANE_END])


def entry(s: Situation, aim: int) -> tuple[int, int]:
    """Whether the ego may enter lane `aim` of its own direction now: (reason, row index), `OPEN` if so.

    With a change under way, `aim` is the lane that it leaves: whether it may be given up.
    """
    ego, lanes = s.rows[0], s.lanes
    x, v = ego[X], ego[VX]
    if s.previous >= 0:
        if int(ego[LANE]) == aim:  # it has not left yet
            return OPEN, -1
    else:
        ends = min(lanes[aim][LANE_END], lanes[s.lane][LANE_END])
        if (
            x > ends - CHANGE_S * v - CHANGE_M
            or x < lanes[aim][LANE_START]
            or x < lanes[s.lane][LANE_OPENS]
            or lanes[aim][LANE_RAMP] > 0.0
        ):
            return NO_LANE, -1
    reason, who = room(s, aim)
    facing = s.near[3 * aim + FACING]
    if reason == OPEN and facing >= 0:  # a car passing head-on in our own lane
        return ONCOMING, facing
    return reason, who


def room(s: Situation, aim: int) -> tuple[int, int]:
    """Whether the cars ahead and behind in lane `aim` leave room to come in: (reason, row index), `OPEN` if so."""
    ego, p = s.rows[0], s.preset
    x, v = ego[X], ego[VX]
    ahead, behind = s.near[3 * aim + AHEAD], s.near[3 * aim + BEHIND]
    if ahead >= 0:
        other = s.rows[ahead]
        slowest = max(other[VX] - doubt(other, DOUBT_VX), 0.0)
        need = rss_same_direction_m(v, slowest, p.reaction_s, 1.0, p.ego_brake, p.lead_brake)
        if gap_m(x, other[X], ego[LENGTH], other[LENGTH]) - doubt(other, DOUBT_X) < need + 1.5:
            return FRONT_GAP, ahead
    if behind >= 0:
        other = s.rows[behind]
        need = follower_gap(other[VX], v, must_leave(s, aim), p)  # courtesy by the best guess, safety by the worst
        fastest = other[VX] + doubt(other, DOUBT_VX)
        need = max(need, follower_gap(fastest, v, True, p) + doubt(other, DOUBT_X))
        if gap_m(other[X], x, other[LENGTH], ego[LENGTH]) < need:
            return REAR_GAP, behind
    return OPEN, -1
