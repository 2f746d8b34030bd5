"""A driver of a few rules that reads what the policy reads: the bar for learning, and what the mask alone is worth."""

from __future__ import annotations

import numpy as np

from schemas.driving.features import FEATURES, Array
from schemas.wire.messages import POLICY_ACTIONS, MetaAction

BLOCKED_M = 60.0
BLOCKED_S = 3.0
ENDS_M = 250.0
_AT = {name: k for k, name in enumerate(FEATURES)}


def rule_logits(x: Array) -> Array:
    """(..., N, F) policy input -> (..., 5) preferences: towards the wished lane, then the wished speed.

    Where no lane is wished, a slower car ahead in the own lane, or the lane's end, is a reason to change, left first.
    """
    own = x[..., 0, :]
    logits = np.zeros((*x.shape[:-2], POLICY_ACTIONS), np.float32)
    spare = own[..., _AT["v_des"]] - own[..., _AT["set_point"]]
    logits[..., MetaAction.SPEED_UP] = np.where(spare > 0.05, 1.0, -1.0)
    logits[..., MetaAction.SLOW_DOWN] = np.where(spare < -0.05, 1.0, -2.0)
    side = own[..., _AT["y_des"]]
    logits[..., MetaAction.LEFT] = np.where(side < -0.5, 3.0, -3.0)
    logits[..., MetaAction.RIGHT] = np.where(side > 0.5, 3.0, -3.0)
    free = own[..., _AT["y_wished"]] == 0
    speed = 10.0 * own[..., _AT["speed"]] + 5.0 * own[..., _AT["dvx"]]
    others = x[..., 1:, :]
    dx, dv = 50.0 * others[..., _AT["dx"]], 5.0 * others[..., _AT["dvx"]]
    reach = np.maximum(BLOCKED_M, BLOCKED_S * speed)[..., None]
    in_lane = (others[..., _AT["presence"]] > 0) & (np.abs(others[..., _AT["dy"]]) < 0.5)
    ahead = in_lane & (dx > 0) & (dx < reach) & (dv < -0.5)
    ends = 100.0 * own[..., _AT["road_left"]] < ENDS_M
    settled = own[..., _AT["changing"]] == 0
    left, right = free & settled & (ahead.any(-1) | ends), free & settled & ahead.any(-1) & ~ends
    logits[..., MetaAction.LEFT] = np.where(left, 2.5, logits[..., MetaAction.LEFT])
    logits[..., MetaAction.RIGHT] = np.where(right, 2.0, logits[..., MetaAction.RIGHT])
    return logits


class RulePolicy:
    """The rule as a policy."""

    def logits(self, x: Array) -> Array:
        """See `Policy.logits`."""
        return rule_logits(x)
