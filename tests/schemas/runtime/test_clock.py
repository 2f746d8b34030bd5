"""The tick schedule, on a clock that moves only when told."""

from __future__ import annotations

from schemas.runtime.clock import NS, ManualClock, Schedule


def test_ticks_are_due_at_computed_times_that_never_drift():
    schedule = Schedule(ManualClock(5), hz=15)
    assert [schedule.wait() for _ in range(31)][-1] == 5 + 2 * NS


def test_ticks_that_have_wholly_passed_are_skipped_and_counted():
    clock = ManualClock()
    schedule = Schedule(clock, hz=15)
    schedule.wait()
    clock.advance(0.5)
    assert (schedule.wait(), schedule.skipped) == (7 * NS // 15, 6)
