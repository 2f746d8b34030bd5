"""A teacher that tries things out: every scene is copied, each copy begins with another plan and goes on by a rule, and
the plan that has earned most after some seconds tells the action.

It knows how the others will drive, which no policy can; what it would do in what a policy sees is what a policy can
learn from it (rollout policy improvement, Bertsekas 2019, section 2.4).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fast_node.training.rollout import Floats, Ints, Scenes
from schemas.driving.features import Array
from schemas.wire.messages import MetaAction

SLOW_DOWN, CRUISE, SPEED_UP, LEFT, RIGHT = (int(a) for a in MetaAction if a != MetaAction.EMERGENCY_BRAKE)
PLANS: tuple[tuple[int, ...], ...] = (
    (),
    (CRUISE,) * 6,
    (SLOW_DOWN,) * 3,
    (SLOW_DOWN,) * 9 + (CRUISE,) * 9,
    (SLOW_DOWN,) * 18 + (CRUISE,) * 9,
    (SPEED_UP,) * 6,
    (LEFT,),
    (RIGHT,),
)
"""Actions, one a decision, before the rule goes on; the first plan is the rule's from the start."""
RULES = -1
AHEAD = 39
"""Decisions: 13 s."""
MARGIN = 0.004
"""Another plan than the rule's must earn this much more."""
GAMMA = 0.997

Logits = Callable[[Array], Array]


class Foresight:
    """The teacher of one `Scenes`."""

    def __init__(self, scenes: Scenes, copies: Scenes, rule: Logits) -> None:
        """copies: scenes of the same task, `len(PLANS)` times as many, whose own episodes do not matter."""
        self._scenes, self._copies, self._rule = scenes, copies, rule
        self.first = np.zeros((len(scenes.wish), len(PLANS)), np.int64)
        """(S, plans) with which action each plan begins."""

    def actions(self) -> tuple[Ints, Floats]:
        """(S,) what to do in every scene now, and (S, plans) what every plan would earn."""
        now, ahead = self._scenes, self._copies
        s, n = len(now.wish), len(PLANS)
        each = np.arange(s * n)
        ahead.become(now, np.repeat(np.arange(s), n))
        earned, going = np.zeros(s * n), np.ones(s * n, np.bool_)
        for k in range(AHEAD):
            is_open = ahead.open()
            action = np.where(is_open, self._rule(ahead.observe()), -np.inf).argmax(-1)
            planned = np.tile([plan[k] if k < len(plan) else RULES for plan in PLANS], s)
            action = np.where((planned != RULES) & is_open[each, planned], planned, action)
            if k == 0:
                self.first = action.reshape(s, n)
            reward, terminated, truncated = ahead.decide(action, redirect=False)
            earned += GAMMA**k * reward * going
            going &= ~(terminated | truncated)
            if not going.any():
                break
        worth = earned.reshape(s, n).copy()
        worth[:, 0] += MARGIN
        return self.first[np.arange(s), worth.argmax(-1)], earned.reshape(s, n)
