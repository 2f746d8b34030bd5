"""The shipped driver: a network for the road, and a plan where a lane must be reached before the task ends.

Where a lane of our direction is intended, the ego is not in it, its own lane does not end before, and the task ends
within 2 km, each of `plans` is tried out on paper, and the ego goes for the speed of the one that opens the change
soonest, at the least loss. When to change lanes the rule says then; everywhere else the network decides. Nothing of the
plan is learnt. The mask has the last word, as over every policy.

Axes: ... any batch axes, B scenes, P plans.
"""

from __future__ import annotations

import numpy as np

from fast_node.policies.plans import NEVER_S, PRESENT, Array, Plans, plans, to_enter
from fast_node.policies.policy import Policy
from fast_node.policies.rule import rule_logits
from schemas.driving import features as f
from schemas.wire.messages import POLICY_ACTIONS, MetaAction

LOST_S_PER_M, TURN_S_PER_MPS = 0.2, 0.3
"""In seconds until the change: what a metre counts that a plan falls behind the wished speed, and a change of speed."""
WORTH_S = 0.2
"""Another plan than the wished speed must be better by this."""
RIGHT_MPS, EXACT_MPS = 0.3, 0.05
"""A set-point that is off by less is right: a decision moves it by half a metre a second, and more would be flutter;
but the wished speed, at which it stops, is reached."""


def best_of(known: Plans) -> Array:
    """(B,) the speed to go for now [m/s]: of the plan that costs least, or the wished one where none gets there."""
    cost = np.where(known.there & (known.open_s < NEVER_S), known.open_s + LOST_S_PER_M * known.lost_m, np.inf)
    cost += TURN_S_PER_MPS * np.abs(known.speed - known.speed[:, PRESENT, None])
    cost[:, 0] -= WORTH_S
    best: Array = known.speed[np.arange(len(cost)), cost.argmin(1)]
    return best


def towards(logits: Array, goal: Array, held: Array, wished: Array) -> Array:
    """Preferences (B, 5) with those of the speed replaced: from a set-point `held` towards `goal`, (B,) each [m/s]. A
    lane change that is preferred stays so."""
    out, off = logits.copy(), goal - held
    right = np.where(np.abs(goal - wished) < EXACT_MPS, EXACT_MPS, RIGHT_MPS)
    out[:, MetaAction.SLOW_DOWN] = np.where(off < -right, 2.0, -1.0)
    out[:, MetaAction.CRUISE] = 0.0
    out[:, MetaAction.SPEED_UP] = np.where(off > right, 1.0, -1.0)
    return out


class GapPolicy:
    """A base policy, and a choice of gap where a lane is to be entered."""

    def __init__(self, base: Policy) -> None:
        self._base = base

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`."""
        flat = x.reshape(-1, *x.shape[-2:])
        side = to_enter(flat)
        planned, rest = np.flatnonzero(side), np.flatnonzero(side == 0)
        if not len(planned):
            return self._base.logits(x)
        out = np.empty((len(flat), POLICY_ACTIONS), np.float32)
        if len(rest):
            out[rest] = self._base.logits(flat[rest])
        seen = flat[planned]
        own = seen[:, 0]
        v = 10.0 * own[:, f.SPEED]
        goal = best_of(plans(seen, side[planned]))
        out[planned] = towards(rule_logits(seen), goal, v + 5.0 * own[:, f.SET_POINT], v + 5.0 * own[:, f.V_DES])
        return out.reshape(*x.shape[:-2], -1)
