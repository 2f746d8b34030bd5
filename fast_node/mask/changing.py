"""Claim: a lane change in progress never traps the ego before a car behind: it is given up while that still helps, and
finished, without crawling, where it does not.

RSS Definition 1 to the car behind in the lane that the ego steers for. Assumed: that car brakes with `follower_brake`
at once while the ego is still mostly in the lane that it leaves, since it sees the change.
"""

from __future__ import annotations

from typing import Any

from fast_node.mask.entering import CREEP_MPS, entry, follower_gap
from fast_node.mask.passing import start_pass
from fast_node.mask.vocabulary import (
    BEHIND,
    CHANGING,
    CRUISE,
    GIVE_UP_CHANGE,
    LEFT,
    NO_LANE,
    OPEN,
    REAR_GAP,
    RIGHT,
    SLOW_DOWN,
    SPEED_UP,
    SPEEDS,
    Situation,
    back_action,
    close,
)
from schemas.driving.measures import rss_same_direction_m
from schemas.driving.road import DOUBT_VX, DOUBT_X, LANE, LANE_WAY, VX, doubt, gap_between


def change_lanes(s: Situation, reasons: Any, vehicle: Any) -> None:
    """LEFT and RIGHT: one change at a time, which the opposite direction gives up; into a lane of our direction as
    `entering` has it, into an oncoming one as `passing` has it."""
    for action in (LEFT, RIGHT):
        aim = s.lane - 1 if action == LEFT else s.lane + 1
        if s.previous >= 0 and aim != s.previous:
            reasons[action] = CHANGING
        elif aim < 0 or aim >= len(s.lanes):
            reasons[action] = NO_LANE
        elif s.lanes[aim][LANE_WAY] > 0:
            reasons[action], vehicle[action] = entry(s, aim)
        else:
            reasons[action], vehicle[action] = start_pass(s, aim)


def settle_change(s: Situation, reasons: Any, vehicle: Any) -> None:
    """A change that a car behind has made unsafe is given up while the ego is still more in the lane that it leaves.
    One that cannot be given up is finished, and not at a crawl: the car behind expects the ego to drive on."""
    behind = s.near[3 * s.lane + BEHIND]
    if s.previous < 0 or behind < 0 or s.lanes[s.lane][LANE_WAY] < 0:
        return
    p, ego, other = s.preset, s.rows[0], s.rows[behind]
    gap, fastest = gap_between(other, ego) - doubt(other, DOUBT_X), other[VX] + doubt(other, DOUBT_VX)
    if reasons[back_action(s)] == OPEN:
        need = 1.0 + rss_same_direction_m(fastest, ego[VX], p.reaction_s, 0.0, p.follower_brake, p.shown_brake)
        if int(ego[LANE]) == s.previous and gap < need:
            for a in SPEEDS:
                close(reasons, vehicle, a, GIVE_UP_CHANGE, behind)
    elif ego[VX] < fastest and gap < follower_gap(fastest, ego[VX], True, p):
        if reasons[SPEED_UP] == OPEN and s.target_speed < CREEP_MPS:
            close(reasons, vehicle, CRUISE, REAR_GAP, behind)
        if reasons[CRUISE] == OPEN or reasons[SPEED_UP] == OPEN:
            close(reasons, vehicle, SLOW_DOWN, REAR_GAP, behind)
