"""Where a new process of the fast node began, told from what was recorded."""

from __future__ import annotations

import pytest

from deploy.replay.tape import Answered, Tape
from schemas.wire.messages import Action, Observation, Status
from tests.scenes import car, observation

TICK_NS = 66_666_667


def beat(stamp_ns: int, pid: int) -> Status:
    return Status(epoch=1, stamp_ns=stamp_ns, node="fast", pid=pid, seq=1, state="ready")


def tape(silent: range, beats: list[tuple[float, int]]) -> Tape:
    """Thirty ticks of which some were not answered, and heartbeats (at which tick, of which process)."""
    seen: list[Observation] = [observation(car(0, 10 * k, 0, 10), epoch=1, tick=k) for k in range(30)]
    answers = [
        Action(epoch=1, stamp_ns=k * TICK_NS, answers_tick=k, meta_action=1, source="policy")
        for k in range(30)
        if k not in silent
    ]
    return Tape(
        observations={(1, one.tick): one for one in seen},
        actions=answers,
        heartbeats=[beat(round(at * TICK_NS), pid) for at, pid in beats],
    )


@pytest.mark.parametrize("first_beat", [19.5, 20.5, 24.5], ids=["before-its-first-action", "after-it", "later"])
def test_a_new_process_begins_after_the_silence_whenever_its_heart_is_heard_first(first_beat):
    found = tape(range(8, 20), [(2.5, 7), (5.5, 7), (first_beat, 8), (27.5, 8)])
    steps = [step for step in found.answered() if isinstance(step, Answered)]
    assert [step.action.answers_tick for step in steps if step.fresh] == [0, 20]


def test_a_process_that_only_misses_ticks_goes_on():
    found = tape(range(8, 20), [(2.5, 7), (5.5, 7), (24.5, 7)])
    steps = [step for step in found.answered() if isinstance(step, Answered)]
    assert [step.action.answers_tick for step in steps if step.fresh] == [0]
