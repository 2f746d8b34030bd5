"""How the car is driven, in one word: NOMINAL, DEGRADED, FAIL-SAFE or STOPPED, with the reason and since when. Pure."""

from __future__ import annotations

from collections import deque

from schemas.driving.road import HZ
from schemas.wire.messages import Action, Mode

POOR_TICKS = 5
"""So many of the last second's ticks without an answer, or with one of the fallback, are too many."""
GOOD_TICKS = 30
"""So many ticks on end without either, and all is well again."""
STANDS_MPS = 0.1


class ModeKeeper:
    """Follows the answers tick by tick."""

    def __init__(self) -> None:
        self.name: Mode = "NOMINAL"
        self.why = ""
        self.since_ns = 0
        """CLOCK_MONOTONIC of the change to it; 0: since the start."""
        self._poor: deque[bool] = deque(maxlen=HZ)
        self._good = 0
        self._last_why = ""

    def tick(self, answer: Action | None, failsafe: bool, speed_mps: float, now_ns: int) -> None:
        """Take in a tick: the action that was applied (None: none came in time), whether the ego is being stopped for
        want of answers, and its speed."""
        poor = answer is None or answer.source == "fallback"
        self._poor.append(poor)
        self._good = 0 if poor else self._good + 1
        if poor:
            self._last_why = "no answer in time" if answer is None else answer.why or "the fallback drives"
        if failsafe:
            stands = speed_mps < STANDS_MPS
            self._become("STOPPED" if stands else "FAIL-SAFE", "no answer from the fast node", now_ns)
        elif self.name in ("FAIL-SAFE", "STOPPED") or sum(self._poor) >= POOR_TICKS:
            self._become("DEGRADED", self._last_why, now_ns)
        elif self.name == "DEGRADED" and self._good >= GOOD_TICKS:
            self._become("NOMINAL", "", now_ns)

    def _become(self, name: Mode, why: str, now_ns: int) -> None:
        if name != self.name:
            self.name, self.why, self.since_ns = name, why, now_ns
