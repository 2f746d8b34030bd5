"""From logits and the mask to one action: what the intent rules out, when to decide and when to hold.

Plain arithmetic on sequences: the node runs it as it is, evaluation in many scenes compiles it with numba unchanged.
"""

from __future__ import annotations

from typing import Any

from fast_node.mask.vocabulary import AHEAD, BRAKE, CRUISE, LEFT, NOT_WISHED, OPEN, RIGHT, SLOW_DOWN, SPEED_UP
from schemas.driving.road import LANE, LANE_RAMP, LANE_WAY, VX, gap_between, lane_ends
from schemas.wire.messages import POLICY_ACTIONS

SOURCES = ("policy", "policy", "masked", "coordination")
HELD, DECIDED, MASKED, WISHED = range(4)
"""Who settled it: the set-points hold; the policy; the mask or the intent against the policy."""

CLOSING_S = 5.0
"""Time to collision below which a leader is not approached on purpose."""
HEADWAY_GAIN = 0.2
DROP_BACK_MPS = 0.5
"""How much slower than a leader the ego drives to regain the wished headway, at most."""
EASE_MPS = 1.5
"""The set-point is lowered for an intent only this far below the speed: comfort, not safety, is at stake."""
STANDSTILL_M = 2.5


def narrow(
    rule: Any,
    rows: Any,
    near: Any,
    lanes: Any,
    target_speed: float,
    target_lane: int,
    previous_lane: int,
    lane: int,
    speed_mps: float,
    headway_s: float,
) -> None:
    """Close in `rule` (6,), of what is safe, what the intent (lane, speed_mps, headway_s) rules out; something milder
    than braking stays open. rows, near, lanes and the set-points: as `mask.close_actions` has them."""
    if rule[LEFT] == OPEN and lanes[target_lane - 1][LANE_WAY] < 0 and lane != target_lane - 1 and others(rule, LEFT):
        rule[LEFT] = NOT_WISHED  # an oncoming lane is not borrowed unasked
    if previous_lane < 0 and go_there(rule, lanes, target_lane, lane):
        return
    if rule[SLOW_DOWN] == OPEN:
        keep_lane(rule, lanes, target_lane, previous_lane, lane)
        keep_speed(rule, rows, near, lanes, target_speed, target_lane, speed_mps, headway_s)


def others(rule: Any, action: int) -> bool:
    """Whether the policy has an open action besides `action`."""
    for a in range(POLICY_ACTIONS):  # noqa: SIM110 — numba compiles no generator
        if a != action and rule[a] == OPEN:
            return True
    return False


def go_there(rule: Any, lanes: Any, target_lane: int, lane: int) -> bool:
    """Leave nothing open but the change towards the intended lane, if that is open and leads to a lane that does not
    end before the road does. Returns whether it is so."""
    if lane < 0 or lane == target_lane:
        return False
    side, aim = (LEFT, target_lane - 1) if lane < target_lane else (RIGHT, target_lane + 1)
    if rule[side] != OPEN or lane_ends(lanes, aim):
        return False
    for a in range(POLICY_ACTIONS):
        if a != side and rule[a] == OPEN:
            rule[a] = NOT_WISHED
    return True


def keep_lane(rule: Any, lanes: Any, target_lane: int, previous_lane: int, lane: int) -> None:
    """Close giving up a change that can go on, and lanes farther from the intended one."""
    if lanes[target_lane][LANE_WAY] < 0:
        return
    if previous_lane >= 0 and rule[CRUISE] == OPEN:
        back = LEFT if previous_lane < target_lane else RIGHT
        if rule[back] == OPEN:
            rule[back] = NOT_WISHED
    if lane >= 0 and not lane_ends(lanes, target_lane):
        if rule[LEFT] == OPEN and lane >= target_lane:
            rule[LEFT] = NOT_WISHED
        if rule[RIGHT] == OPEN and lane <= target_lane:
            rule[RIGHT] = NOT_WISHED


def keep_speed(
    rule: Any,
    rows: Any,
    near: Any,
    lanes: Any,
    target_speed: float,
    target_lane: int,
    speed_mps: float,
    headway_s: float,
) -> None:
    """Close set-points too fast for the intended speed, or for the intended headway to the car ahead."""
    ego = rows[0]
    ceiling = speed_mps
    lead = int(near[3 * target_lane + AHEAD])
    if lead >= 0 and int(rows[lead][LANE]) == target_lane and lanes[target_lane][LANE_RAMP] == 0.0:
        lead_mps = rows[lead][VX]
        gap = gap_between(ego, rows[lead])
        spare = max(HEADWAY_GAIN * (gap - STANDSTILL_M - headway_s * lead_mps), -DROP_BACK_MPS)
        ceiling = min(ceiling, lead_mps + min(max(gap - STANDSTILL_M, 0.0) / CLOSING_S, spare))
    if rule[CRUISE] == OPEN and target_speed > ceiling + 0.01 and target_speed > ego[VX] - EASE_MPS:
        rule[CRUISE] = NOT_WISHED
    if rule[SPEED_UP] == OPEN and (target_speed >= speed_mps or min(target_speed + 1.0, speed_mps) > ceiling):
        rule[SPEED_UP] = NOT_WISHED


def choose(logits: Any, rule: Any, holding: bool) -> tuple[int, int]:
    """(meta-action, who settled it) from five logits and the rules (6,) that close actions, `narrow` included.

    `holding`: less than a decision interval has passed since the last decision; then the set-points hold unless that
    is closed, or a lane change that the policy wants is open.
    """
    wanted = 0
    best = -1
    for a in range(POLICY_ACTIONS):
        if logits[a] > logits[wanted]:
            wanted = a
        if rule[a] == OPEN and (best < 0 or logits[a] > logits[best]):
            best = a
    if holding and rule[CRUISE] == OPEN and not (wanted >= LEFT and rule[wanted] == OPEN):
        return CRUISE, HELD
    if best < 0:
        return BRAKE, MASKED
    if best == wanted:
        return best, DECIDED
    return best, WISHED if rule[wanted] == NOT_WISHED else MASKED
