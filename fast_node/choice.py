"""From logits and the mask to one action: when to decide, when to hold, and the way home from a borrowed lane.

Plain arithmetic on sequences: the node runs it as it is, evaluation in many scenes compiles it with numba unchanged.
"""

from __future__ import annotations

from typing import Any

from fast_node.mask import NOTHING_TO_PASS, OPEN
from schemas.messages import POLICY_ACTIONS, MetaAction

SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT, BRAKE = (int(a) for a in MetaAction)

SOURCES = ("policy", "policy", "masked", "coordination")
HELD, DECIDED, MASKED, HOMEWARD = range(4)
"""Who settled it: the set-points hold; the policy; the mask against the policy; the rule that leads home."""


def invite(rule: Any, lanes: Any, target_lane: int, wish_lane: int) -> None:
    """Close LEFT in `rule` (6,) where it leads into an oncoming lane that nobody wishes to borrow."""
    if rule[LEFT] == OPEN and lanes[target_lane - 1][3] < 0 and wish_lane != target_lane - 1:
        rule[LEFT] = NOTHING_TO_PASS


def choose(
    logits: Any, rule: Any, holding: bool, direction: float, target_lane: int, wish_lane: int
) -> tuple[int, int]:
    """(meta-action, who settled it) from five logits and the rules (6,) that close actions.

    `holding`: less than a decision interval has passed since the last decision; then the set-points hold unless the
    mask closes that, or a lane change that the policy wants is open. `direction`: of the lane aimed for.
    """
    wanted = 0
    best = -1
    for a in range(POLICY_ACTIONS):
        if logits[a] > logits[wanted]:
            wanted = a
        if rule[a] == OPEN and (best < 0 or logits[a] > logits[best]):
            best = a
    if direction < 0.0 and wish_lane > target_lane and rule[RIGHT] == OPEN and best != RIGHT:
        return RIGHT, HOMEWARD
    if holding and rule[CRUISE] == OPEN and not (wanted >= LEFT and rule[wanted] == OPEN):
        return CRUISE, HELD
    if best < 0:
        return BRAKE, MASKED
    return best, DECIDED if best == wanted else MASKED
