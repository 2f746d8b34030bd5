"""Time: a monotonic clock for the road, a manual one for tests and lock-step runs, and an absolute schedule."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

NS = 1_000_000_000


class Clock(Protocol):
    """Nanoseconds since an arbitrary origin, never going back."""

    def now_ns(self) -> int: ...

    def sleep_until(self, due_ns: int) -> None: ...


class MonotonicClock:
    """CLOCK_MONOTONIC: comparable between the processes of one host."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until(self, due_ns: int) -> None:
        """Sleep until `due_ns`; return at once if it has passed."""
        left = due_ns - time.monotonic_ns()
        if left > 0:
            time.sleep(left / NS)


class ManualClock:
    """A clock that moves only when told; sleeping moves it."""

    def __init__(self, now_ns: int = 0) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until(self, due_ns: int) -> None:
        self._now_ns = max(self._now_ns, due_ns)

    def advance(self, seconds: float) -> None:
        self._now_ns += round(seconds * NS)


class Schedule:
    """Tick k is due at `start_ns + k * NS // hz`: computed, never accumulated. Late ticks are skipped and counted."""

    def __init__(self, clock: Clock, hz: int, start_ns: int | None = None) -> None:
        self._clock, self._hz = clock, hz
        self._start_ns = clock.now_ns() if start_ns is None else start_ns
        self._next = 0
        self.skipped = 0

    def due_ns(self, k: int) -> int:
        return self._start_ns + k * NS // self._hz

    def wait(self, stop: Callable[[], bool] = lambda: False) -> int:
        """Sleep until the next due time and return it; times that have wholly passed are skipped."""
        behind = max(0, (self._clock.now_ns() - self._start_ns) * self._hz // NS)
        if behind > self._next:
            self.skipped += behind - self._next
            self._next = behind
        due = self.due_ns(self._next)
        self._next += 1
        if not stop():
            self._clock.sleep_until(due)
        return due
