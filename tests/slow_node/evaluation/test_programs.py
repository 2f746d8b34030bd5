"""Labels of programs and dialogues: what is right, what is not, and that every label can be met."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from schemas.wire.program import Program
from slow_node.evaluation.programs import DIALOGUES_SET, PROGRAMS_SET, met, right
from slow_node.evaluation.score import read_lines
from slow_node.planning.directive import directive_of
from slow_node.understanding.slots import Slots
from tests.ride import scene

LABELS = read_lines(PROGRAMS_SET)


def test_every_label_is_a_program_that_could_be_sent() -> None:
    for label in LABELS:
        for steps in (label["steps"], *label["also"]):
            msgspec.convert({"outcome": label["outcome"], "steps": steps, "question": label["question"]}, Program)


def test_every_label_is_met_by_itself_and_by_each_of_its_other_readings() -> None:
    for label in LABELS:
        for steps in (label["steps"], *label["also"]):
            assert right(label, {**label, "steps": steps})


@pytest.mark.parametrize(
    "steps",
    [
        [],
        [{"act": "lane", "side": "right", "count": 1}],
        [{"act": "lane", "side": "left", "count": 1, "when": {"kind": "time", "value": 9.0}}],
        [{"act": "lane", "side": "left", "count": 1}, {"act": "stop"}],
    ],
)
def test_another_step_another_side_another_time_and_a_step_more_are_wrong(steps: list[dict[str, Any]]) -> None:
    wish = {"act": "lane", "side": "left", "count": 1}
    label = {"outcome": "directive", "question": "", "steps": [wish], "also": []}
    assert not right(label, {"outcome": "directive", "steps": steps})
    assert right(label, {"outcome": "directive", "steps": [wish]})


def test_a_turn_is_judged_by_what_its_directive_changes() -> None:
    now = scene(1, speed=15.0)
    slower = directive_of(Slots(outcome="directive", speed="slower"), now)
    assert met({"speed": "down"}, now, slower, [])  # type: ignore[arg-type]
    assert not met({"speed": "up"}, now, slower, [])  # type: ignore[arg-type]
    assert not met({"lane": 0}, now, slower, [])  # type: ignore[arg-type]
    assert not met({"speed": "down"}, now, None, [])


def test_twenty_dialogues_have_three_to_five_turns() -> None:
    dialogues = read_lines(DIALOGUES_SET)
    assert len(dialogues) == 20
    assert {len(dialogue["turns"]) for dialogue in dialogues} <= {3, 4, 5}
