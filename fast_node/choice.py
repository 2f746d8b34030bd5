"""From logits and the mask to one action: what the wish rules out, when to decide and when to hold.

Plain arithmetic on sequences: the node runs it as it is, evaluation in many scenes compiles it with numba unchanged.
"""

from __future__ import annotations

from typing import Any

from fast_node.mask import NOT_WISHED, OPEN
from schemas.wire.messages import POLICY_ACTIONS, MetaAction

SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT, BRAKE = (int(a) for a in MetaAction)

SOURCES = ("policy", "policy", "masked", "coordination")
HELD, DECIDED, MASKED, WISHED = range(4)
"""Who settled it: the set-points hold; the policy; the mask or the wish against the policy."""

CLOSING_S = 5.0
"""Time to collision below which a leader is not approached on purpose."""
HEADWAY_GAIN = 0.2
DROP_BACK_MPS = 0.5
"""How much slower than a leader the ego drives to regain the wished headway, at most."""
EASE_MPS = 1.5
"""The set-point is lowered for a wish only this far below the speed: comfort, not safety, is at stake."""
STANDSTILL_M = 2.5


def narrow(
    rule: Any,
    rows: Any,
    near: Any,
    lanes: Any,
    target_speed: float,
    target_lane: int,
    previous_lane: int,
    wish_lane: int,
    wish_mps: float,
    headway_s: float,
) -> None:
    """Close in `rule` (6,), of what is safe, what the wish rules out: everything but the change towards the wished lane
    once that is open, lanes away from it, giving up a change that can go on, an oncoming lane that nobody wishes to
    borrow, and speeds too fast for the wish or for the wished headway to the car ahead.

    Something milder than braking stays open. rows, near, lanes: as `mask.close_actions` has them.
    """
    if rule[LEFT] == OPEN and lanes[target_lane - 1][3] < 0 and wish_lane != target_lane - 1:
        for a in range(POLICY_ACTIONS):
            if a != LEFT and rule[a] == OPEN:
                rule[LEFT] = NOT_WISHED
    longest = 0.0
    for k in range(len(lanes)):
        longest = max(longest, lanes[k][2])
    if wish_lane >= 0 and wish_lane != target_lane and previous_lane < 0:
        side = LEFT if wish_lane < target_lane else RIGHT
        if rule[side] == OPEN and lanes[target_lane + (1 if side == RIGHT else -1)][2] == longest:
            for a in range(POLICY_ACTIONS):
                if a != side and rule[a] == OPEN:
                    rule[a] = NOT_WISHED
            return
    if rule[SLOW_DOWN] != OPEN:
        return
    if previous_lane >= 0 and rule[CRUISE] == OPEN and lanes[target_lane][3] > 0:
        back = LEFT if previous_lane < target_lane else RIGHT
        if rule[back] == OPEN:
            rule[back] = NOT_WISHED
    if wish_lane >= 0 and lanes[target_lane][3] > 0 and lanes[target_lane][2] == longest:
        if rule[LEFT] == OPEN and wish_lane >= target_lane:
            rule[LEFT] = NOT_WISHED
        if rule[RIGHT] == OPEN and wish_lane <= target_lane:
            rule[RIGHT] = NOT_WISHED
    ego = rows[0]
    ceiling = wish_mps
    lead = int(near[3 * target_lane])
    if lead >= 0 and int(rows[lead][8]) == target_lane and lanes[target_lane][7] == 0.0:
        lead_mps = rows[lead][3]
        gap = rows[lead][1] - ego[1] - 0.5 * (rows[lead][6] + ego[6])
        spare = max(HEADWAY_GAIN * (gap - STANDSTILL_M - headway_s * lead_mps), -DROP_BACK_MPS)
        ceiling = min(ceiling, lead_mps + min(max(gap - STANDSTILL_M, 0.0) / CLOSING_S, spare))
    if rule[CRUISE] == OPEN and target_speed > ceiling + 0.01 and target_speed > ego[3] - EASE_MPS:
        rule[CRUISE] = NOT_WISHED
    if rule[SPEED_UP] == OPEN and (target_speed >= wish_mps or min(target_speed + 1.0, wish_mps) > ceiling):
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
