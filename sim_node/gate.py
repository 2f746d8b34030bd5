"""Which action answers the observation that was just published: the first one, if it comes within the budget. Pure."""

from __future__ import annotations

import math
from collections import deque

from schemas.wire.messages import Action, MetaAction
from sim_node.executor import STYLE_ACCEL_MPS2

KEPT = 9000
"""Ticks in the percentiles: the last ten minutes."""


def answers(action: Action, epoch: int, tick: int) -> bool:
    """Whether it is an answer to this very observation, and an action that exists."""
    return (
        (action.epoch, action.answers_tick) == (epoch, tick)
        and 0 <= action.meta_action < len(MetaAction)
        and 0 <= action.style < len(STYLE_ACCEL_MPS2)
        and not math.isnan(action.speed_cap_mps or 0.0)
    )


class Gate:
    """Open from an observation's publication until its first answer has come, or the budget is over.

    The budget is the simulator's own or the one that the action states, whichever is smaller. An answer that comes
    later is not used: its tick counts as missed, as one without any answer does. All times are CLOCK_MONOTONIC [ns].
    """

    def __init__(self, budget_ns: int) -> None:
        self._budget_ns = budget_ns
        self._asked = (-1, -1)
        self._answer: Action | None = None
        self._open = False
        self.published_ns = 0
        self.took_ns = -1
        """From the publication to the first answer, used or too late; -1 while there is none."""
        self.age_ns = -1
        """From the publication until the action was applied; -1 where none was."""
        self.missed = 0
        """Observations without an answer in time."""
        self.strays = 0
        """Actions that the fast node cannot have meant: of another world, of a tick to come, a second one for the same
        tick, or none that exists."""
        self.round_trips_ns: deque[int] = deque(maxlen=KEPT)
        """Of all first answers, those that came too late included."""
        self.ages_ns: deque[int] = deque(maxlen=KEPT)
        """Of all actions that were applied."""

    @property
    def until_ns(self) -> int:
        """What comes after this is too late."""
        return self.published_ns + self._budget_ns

    def open(self, epoch: int, tick: int, now_ns: int) -> None:
        """This observation is about to be published."""
        self._asked, self.published_ns, self._open = (epoch, tick), now_ns, True
        self._answer, self.took_ns, self.age_ns = None, -1, -1

    def arrived(self, action: Action, at_ns: int) -> None:
        """Take in an action. All but the first answer to the newest observation are without effect."""
        epoch, tick = self._asked
        if self.took_ns >= 0 or not answers(action, epoch, tick):
            self.strays += action.epoch != epoch or action.answers_tick >= tick
            return
        self.took_ns = at_ns - self.published_ns
        self.round_trips_ns.append(self.took_ns)
        if self._open and self.took_ns <= min(self._budget_ns, action.budget_ns or self._budget_ns):
            self._answer = action

    def close(self, now_ns: int) -> Action | None:
        """The answer to apply now; None where none came in time, which is counted."""
        self._open = False
        if self._answer is None:
            self.missed += 1
        else:
            self.age_ns = now_ns - self.published_ns
            self.ages_ns.append(self.age_ns)
        return self._answer
