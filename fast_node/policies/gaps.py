"""The choice of a gap, where a lane must be reached before the ego's own lane, or the task, ends.

There each of `plans` is tried out on paper, and the ego goes for the speed of the plan that costs least: a weighted sum
of what is known of it (`GAPS`). Before a lane's end the weights are learnt, from the ride score of whole episodes
(`fast_node.training.plan_weights`); before the end of a task they are those by hand, since learning has found none that
are better. When to change lanes the rule says then; everywhere else the base policy decides. The mask has the last
word, as over every policy.

Axes: ... any batch axes, B scenes, P plans.
"""

from __future__ import annotations

import numpy as np

from fast_node.policies.on_paper import way
from fast_node.policies.plans import (
    LEFT_MOST_M,
    NEVER_S,
    PLANS,
    PRESENT,
    RANKS,
    SPARE_MOST_M,
    SPEEDS,
    Array,
    Plans,
    own_lane_ends,
    plans,
    to_enter,
)
from fast_node.policies.policy import Policy
from fast_node.policies.rule import rule_logits
from fast_node.policies.weights import CHECKPOINTS, Described
from schemas.driving import features as f
from schemas.wire.messages import POLICY_ACTIONS, MetaAction

GAPS = Described(
    names=("open", "never", "lost", "turn", "up", "wished", "present", "left", "spare", "ahead", "behind", "slower"),
    by_hand={"open": 10.0, "lost": 10.0, "turn": 1.5, "wished": -0.2},
    shipped=CHECKPOINTS / "gaps.json",
    command="make gaps",
)
"""Of each plan: open_s / 10, or whether it never opens; lost_m / 50; by how much the set-point has to change, and to
rise, / 5; whether it is the wished speed, or the present one; left_m / 300; spare_m / 20; whether it is a car ahead of
the ego, or behind it, that is fallen in behind; by how much it is slower than wished, / 10. By hand, in seconds: a
metre that is lost counts 0.2, and a change of speed 0.3 for each m/s; another plan than the wished speed must be better
by 0.2."""


def described(known: Plans) -> Array:
    """(B, P, D) what is known of every plan, in numbers of about 1."""
    opens = known.open_s < NEVER_S
    turn = known.speed - known.speed[:, PRESENT, None]
    plan = np.arange(PLANS)
    rank = np.concatenate([np.zeros(SPEEDS), RANKS])
    columns = (
        np.where(opens, known.open_s / 10.0, 0.0),
        ~opens,
        known.lost_m / 50.0,
        np.abs(turn) / 5.0,
        np.maximum(turn, 0.0) / 5.0,
        plan == 0,
        plan == PRESENT,
        known.left_m / LEFT_MOST_M,
        known.spare_m / SPARE_MOST_M,
        rank > 0,
        rank < 0,
        (known.speed[:, :1] - known.speed) / 10.0,
    )
    return np.stack([np.broadcast_to(column, known.there.shape) for column in columns], -1).astype(np.float32)


def best_of(known: Plans, weights: Array | None = None) -> Array:
    """(B,) the speed to go for now [m/s], by weights (D,) of `GAPS`; None: by hand, which is the wished speed
    where no plan gets there."""
    by_hand = weights is None
    cost = described(known) @ (GAPS.in_order(GAPS.by_hand) if weights is None else weights)
    cost = np.where(known.there & ((known.open_s < NEVER_S) | (not by_hand)), cost, np.inf)
    best: Array = known.speed[np.arange(len(cost)), cost.argmin(1)]
    return best


def towards(logits: Array, goal: Array, held: Array, wished: Array) -> Array:
    """Preferences (B, 5) with those of the speed replaced: from a set-point `held` towards `goal`, (B,) each [m/s]. A
    lane change that is preferred stays so."""
    out, turn = logits.copy(), way(goal, held, wished)
    out[:, MetaAction.SLOW_DOWN] = np.where(turn < 0, 2.0, -1.0)
    out[:, MetaAction.CRUISE] = 0.0
    out[:, MetaAction.SPEED_UP] = np.where(turn > 0, 1.0, -1.0)
    return out


class GapPolicy:
    """A base policy, and a choice of gap where a lane is to be entered."""

    def __init__(self, base: Policy, weights: Array | None = None) -> None:
        """weights: (D,) of `GAPS`, where the own lane ends; None: by hand there, too."""
        self._base, self._weights = base, weights

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
        known = plans(seen, side[planned])
        goal = np.where(own_lane_ends(seen), best_of(known, self._weights), best_of(known))
        out[planned] = towards(rule_logits(seen), goal, v + 5.0 * own[:, f.SET_POINT], v + 5.0 * own[:, f.V_DES])
        return out.reshape(*x.shape[:-2], -1)
