"""What every claim of the mask speaks in: actions, reasons, what is assumed of others, and the situation to judge."""

from __future__ import annotations

from typing import Any, NamedTuple

from schemas.wire.messages import MetaAction, Reason

VERSION = "mask/8"
"""Of what mask and `choice` do: tests hold a digest of their behaviour against it. A policy learns behind one version
and drives behind no other."""

SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT, BRAKE = (int(a) for a in MetaAction)
SPEEDS = (SLOW_DOWN, CRUISE, SPEED_UP)
"""The actions that stay in the lane."""

REASONS = ("", *Reason)
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
) = range(len(REASONS))

AHEAD, BEHIND, FACING = range(3)
"""A lane's places in what `neighbours.survey` finds: near[3 * lane + place]; FACING: oncoming, and ahead."""


class Preset(NamedTuple):
    """What is assumed of the ego and of others; s, m, m/s2 (brakes as magnitudes)."""

    reaction_s: float
    """Until the ego brakes."""
    ego_brake: float
    """What the ego is sure to manage; it manages 1 m/s2 more where it brakes straight on."""
    shown_brake: float
    """The most that the ego brakes with before a car behind, but for an emergency."""
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
    # Our executor answers within one tick and brakes at 8; cars ahead brake as on a dry road.
    "sim": Preset(
        reaction_s=2.0 / 15.0,
        ego_brake=7.0,
        shown_brake=5.0,
        lead_brake=9.0,
        standstill_m=2.5,
        follow_s=0.7,
        ceiling_reaction_s=0.3,
        ceiling_brake=6.5,
        follower_reaction_s=0.8,
        follower_brake=6.0,
        courtesy_brake=1.9,
        side_accel=0.2,
        side_brake=2.0,
        sway_m=0.3,
    ),
    # For traffic that brakes harder and reacts later than ours.
    "cautious": Preset(
        reaction_s=0.3,
        ego_brake=6.0,
        shown_brake=4.5,
        lead_brake=9.5,
        standstill_m=3.0,
        follow_s=1.0,
        ceiling_reaction_s=0.4,
        ceiling_brake=5.5,
        follower_reaction_s=1.0,
        follower_brake=5.0,
        courtesy_brake=1.5,
        side_accel=0.3,
        side_brake=1.5,
        sway_m=0.4,
    ),
}


class Situation(NamedTuple):
    """All that a claim may read: never the directive."""

    rows: Any
    """(V, 9) vehicles in `road`'s columns, the ego first."""
    lanes: Any
    """(L, 8) as `road.lane_table`."""
    near: Any
    """(3 L,) row indices that `neighbours.survey` has found."""
    target_speed: float
    """The executor's speed set-point [m/s]."""
    lane: int
    """The lane that the executor steers for."""
    previous: int
    """The lane that a running change leaves; -1 without one."""
    sight: float
    """How far the ego sees [m]."""
    road_end: float
    """Where the longest lane ends [m]."""
    preset: Preset


def close(reasons: Any, vehicle: Any, action: int, reason: int, who: int) -> None:
    """Close `action` for `reason` and row `who`, unless it is closed already: the first reason stands."""
    if reasons[action] == OPEN:
        reasons[action] = reason
        vehicle[action] = who


def close_again(reasons: Any, vehicle: Any, action: int, reason: int, who: int) -> None:
    """Close `action` for `reason` and row `who`, whatever has closed it before: the last reason stands."""
    reasons[action] = reason
    vehicle[action] = who


def back_action(s: Situation) -> int:
    """The action that gives the running change up; -1 without one."""
    if s.previous < 0:
        return -1
    return LEFT if s.previous < s.lane else RIGHT
