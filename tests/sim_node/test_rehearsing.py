"""The simulator's clock, which announces a tick before it is due."""

from __future__ import annotations

import pytest

from schemas.runtime.clock import ManualClock, MonotonicClock
from sim_node.__main__ import REHEARSALS_NS, RehearsingClock


class Announced:
    """Counts the announcements."""

    def __init__(self) -> None:
        self.times = 0

    def announce_next(self, _: object) -> None:
        self.times += 1


@pytest.mark.parametrize(("ahead_ns", "times"), [(50_000_000, len(REHEARSALS_NS)), (-1, 0)])
def test_a_tick_is_announced_unless_it_is_late(ahead_ns: int, times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    announced, manual = Announced(), ManualClock()
    monkeypatch.setattr(MonotonicClock, "now_ns", lambda _: manual.now_ns())
    monkeypatch.setattr(MonotonicClock, "sleep_until", lambda _, due_ns: manual.sleep_until(due_ns))
    RehearsingClock(announced, poll=False).sleep_until(ahead_ns)  # type: ignore[arg-type]
    assert announced.times == times
