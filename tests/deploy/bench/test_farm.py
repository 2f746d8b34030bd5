"""When the last of many tasks is done, by hand-computed cases."""

from __future__ import annotations

import pytest

from deploy.bench.farm import finished_s


@pytest.mark.parametrize(
    ("lengths", "slots", "start", "hand_out", "done"),
    [
        ([4.0, 4.0, 4.0, 4.0], 2, 0.0, 0.0, 8.0),
        ([4.0, 4.0, 4.0, 4.0], 2, 5.0, 0.0, 13.0),
        ([1.0, 1.0, 9.0], 2, 0.0, 0.0, 10.0),
        ([1.0, 1.0, 1.0], 9, 0.0, 2.0, 7.0),
    ],
)
def test_the_last_task_is_done_when_its_slot_was_free_and_it_was_handed_out(
    lengths: list[float], slots: int, start: float, hand_out: float, done: float
) -> None:
    assert finished_s(lengths, slots, start, hand_out) == pytest.approx(done)
