"""Labels of programs and dialogues: what is right, what is not, and that every label can be met."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import msgspec
import pytest

from schemas.runtime.process import ConfigError
from schemas.wire.messages import Reply
from schemas.wire.program import Program
from slow_node.evaluation.programs import EXAMS, exam_lines, met, refusals, right
from slow_node.evaluation.score import plain_text
from slow_node.planning.directive import directive_of
from slow_node.understanding.slots import Slots
from tests.ride import scene

LABELS = [
    label
    for name in ("programs", "strangers", "strangers-2", "strangers-3", "strangers-4")
    for label in exam_lines(EXAMS[name])
]


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


def test_what_is_refused_wrongly_and_what_is_not_refused_is_counted() -> None:
    said = [("directive", "refused"), ("unclear", "directive"), ("refused", "directive"), ("refused", "unclear")]
    labels, outputs = ([{"outcome": pair[k]} for pair in said] for k in (0, 1))
    assert refusals(labels, outputs) == {
        "harmless_refused": {"count": 1, "n": 2},
        "dangerous_directive": {"count": 1, "n": 2},
    }


def test_slower_by_any_amount_is_slower_but_a_speed_that_nobody_named_is_not() -> None:
    label = {"outcome": "directive", "question": "", "steps": [{"act": "slower"}], "also": []}
    for size, is_right in (
        ({"value": 0.8, "unit": "times", "mode": "factor"}, True),
        ({"value": 2.8, "unit": "mps", "mode": "by"}, True),
        ({"value": 20.0, "unit": "mps", "mode": "to"}, False),
    ):
        assert right(label, {"outcome": "directive", "steps": [{"act": "slower", **size}]}) is is_right
    exact = {**label, "steps": [{"act": "slower", "value": 0.5, "unit": "times", "mode": "factor"}]}
    assert not right(exact, {"outcome": "directive", "steps": [{"act": "slower"}]})


def test_a_turn_is_judged_by_what_its_directive_changes() -> None:
    now = scene(1, speed=15.0)
    slower = directive_of(Slots(outcome="directive", speed="slower"), now)
    assert met({"speed": "down"}, now, slower, [])  # type: ignore[arg-type]
    assert not met({"speed": "up"}, now, slower, [])  # type: ignore[arg-type]
    assert not met({"lane": 0}, now, slower, [])  # type: ignore[arg-type]
    assert not met({"speed": "down"}, now, None, [])


@pytest.mark.parametrize(
    ("outcome", "why"),
    [
        ("refused", "unsafe command: heard: refused"),
        ("refused", "40 m/s is far over the limit"),
        ("out_of_scope", "not about driving: heard: out of scope"),
        ("unclear", "unclear command: left or right?"),
    ],
)
def test_what_is_not_driven_is_judged_by_why(outcome: str, why: str) -> None:
    now, reply = scene(1), Reply(epoch=0, stamp_ns=0, command_id=1, outcome="refused", text="", why=why)
    for other in ("refused", "out_of_scope", "unclear"):
        assert met({"outcome": other}, now, None, [reply]) is (other == outcome)


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("dialogues", 20),
        ("strangers-dialogues", 60),
        ("strangers-2-dialogues", 30),
        ("strangers-3-dialogues", 48),
        ("strangers-4-dialogues", 60),
    ],
)
def test_dialogues_have_three_to_five_turns(name: str, count: int) -> None:
    dialogues = exam_lines(EXAMS[name])
    assert len(dialogues) == count
    assert {len(dialogue["turns"]) for dialogue in dialogues} <= {3, 4, 5}


def test_no_command_of_the_strangers_is_there_twice() -> None:
    texts = [
        plain_text(label["text"])
        for name in ("strangers", "strangers-2", "strangers-3", "strangers-4")
        for label in exam_lines(EXAMS[name])
    ]
    assert len(texts) == len(set(texts)) >= 2100


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "it has no line"),
        ("{", "line 1: not JSON"),
        ('{"id": 1, "text": "faster"}', "line 1: Object missing required field `outcome`"),
        (
            '{"id": 1, "text": "x", "outcome": "directive", "steps": [{"act": "fly"}]}',
            "line 1: Invalid enum value 'fly'",
        ),
        ('{"id": 1, "turns": [{"say": "x", "expect": {"mood": 1}}]}', "line 1: Invalid enum value 'mood'"),
        ('{"id": 1, "turns": [{"say": "x", "expect": {}}]}', "line 1: Expected `object` of length >= 1"),
        ('{"id": 1, "text": "x", "outcome": "unclear"}\n{"id": 2, "turns": []}', "line 2: Object missing"),
    ],
)
def test_a_file_that_is_no_exam_is_refused_by_the_line_that_is_wrong(tmp_path: Path, content: str, told: str) -> None:
    path = tmp_path / "mine.jsonl"
    path.write_text(content)
    with pytest.raises(ConfigError, match=re.escape(told)):
        exam_lines(path)
