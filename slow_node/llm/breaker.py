"""Leaves a server that keeps failing alone for a while, and then probes it with a single call."""

from __future__ import annotations

import time
from collections.abc import Callable

BREAK_AFTER = 3
"""This many failed calls in a row open the breaker."""
BREAK_S, BREAK_MAX_S = 5.0, 60.0
"""How long it stays open: doubled by every probe that fails."""


class Breaker:
    """Closed; open after `BREAK_AFTER` failures in a row; half open, for one call, once its pause is over.

    Each call that `enter` lets through ends in `succeeded`, `failed` or `dropped`. Times in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._failures = 0
        self._pause_s = BREAK_S
        self._until = 0.0
        self._probing = False

    @property
    def waits_s(self) -> float:
        """How long no call is allowed; 0 when one is, or while one probes."""
        return max(0.0, self._until - self._clock())

    def enter(self) -> bool:
        """Whether a call may start now."""
        if self._probing or self.waits_s:
            return False
        self._probing = self._failures >= BREAK_AFTER
        return True

    def dropped(self) -> None:
        """The call was given up by its caller: it says nothing about the server."""
        self._probing = False

    def succeeded(self) -> None:
        self._failures, self._pause_s, self._until, self._probing = 0, BREAK_S, 0.0, False

    def failed(self) -> None:
        self._probing = False
        self._failures += 1
        if self._failures >= BREAK_AFTER:
            self._until = self._clock() + self._pause_s
            self._pause_s = min(2.0 * self._pause_s, BREAK_MAX_S)
