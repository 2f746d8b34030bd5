"""`fastslow interpret` and `fastslow memory`: what goes in, what comes out, and what the intent parser understands."""

from __future__ import annotations

import json
import os
from collections import Counter
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from deploy.cli.app import app
from deploy.lab.interpret import DEFAULT_SCENE, SCENE_KEYS, LineError, interpret_lines, scene_of
from deploy.lab.interpret_score import labelled_set
from schemas.wire.messages import Directive
from slow_node.interpreter import Interpreter
from slow_node.llm.embedding import load_embedder
from slow_node.planning.directive import Refusal, directive_of
from slow_node.planning.replies import sentence
from slow_node.training.generate import in_scenes
from slow_node.training.generator import Generator
from slow_node.training.stock import Frame, Sample, Stock, load_stock
from slow_node.understanding.intent_parser import HEADS, IntentParser
from slow_node.understanding.slots import Slots

run = CliRunner()


@pytest.fixture(scope="module")
def parser() -> IntentParser:
    found = IntentParser.load(load_embedder())
    if found is None:
        pytest.skip("MiniLM or the parser's weights are not installed")
    return found


def interpret(text: str, *options: str) -> list[dict[str, object]]:
    """The output lines of `fastslow interpret` for an input text."""
    result = run.invoke(app, ["interpret", "--input", "-", "--ask", "never", *options], input=text)
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_every_line_yields_one_line_with_all_its_keys(parser: IntentParser, tmp_path: Path) -> None:
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps({"lanes": 2, "ego_lane": 0, "vehicles": []}))
    lines = [
        '{"id": 7, "text": "please slow down"}',
        "not json",
        '{"id": "x"}',
        "",
        '{"id": "l", "text": "change to the left lane"}',
        '{"id": "s", "text": "change to the left lane", "scene": {"lanes": 4, "ego_lane": 2}}',
        '["a list"]',
    ]
    rows = interpret("\n".join(lines), "--scene", str(scene))
    assert [row["id"] for row in rows] == [7, "line-2", "x", "l", "s", "line-7"]
    assert [row["outcome"] for row in rows] == ["directive", "error", "error", "refused", "directive", "error"]
    assert {
        "id",
        "text",
        "outcome",
        "directive",
        "slots",
        "say",
        "reasoning",
        "latency_s",
        "model",
        "retrieved",
    } <= set(rows[0])
    assert rows[0]["slots"] == {
        "speed": "slower",
        "target_speed_mps": None,
        "lane": None,
        "gap": None,
        "headway_s": None,
        "overtake": None,
        "cancel": False,
    }


def test_a_generated_command_has_a_scene_that_interpret_takes_and_numbers_resolved_against_it() -> None:
    label = {name: classes[0] for name, classes in HEADS.items()}
    sample = Sample("ten km/h faster", "en", {**label, "speed": "faster", "number": "delta"})
    rows = list(in_scenes([sample] * 20, seed=0))
    scenes = [scene_of(row["scene"]) for row in rows]
    assert len({scene.speed_mps for scene in scenes}) > 10
    assert [row["slots"]["target_speed_mps"] for row in rows] == [  # type: ignore[index]
        pytest.approx(min(scene.speed_mps + 10 / 3.6, scene.limit_mps), abs=0.01) for scene in scenes
    ]


def test_a_generated_commands_labels_are_those_of_an_exam() -> None:
    rows = list(in_scenes(Generator(load_stock(), 5).samples(100)[-2000:], seed=0))
    exam = labelled_set("dev")
    assert all(set(row["slots"]) == set(exam[0]["slots"]) for row in rows)  # type: ignore[call-overload]
    assert {row["outcome"] for row in rows} == {row["outcome"] for row in exam}


def test_a_missing_input_is_a_usage_error_with_its_name() -> None:
    result = run.invoke(app, ["interpret", "--input", "/nowhere/commands.jsonl"])
    assert result.exit_code == 2
    assert "commands.jsonl" in result.stderr


def test_a_line_of_any_length_costs_its_own_answer_alone() -> None:
    wrote: list[dict[str, Any]] = []
    interpreter = cast(Interpreter, SimpleNamespace(close=closed, model_name="m"))
    lines = [
        None,
        b"[" * 50_000,
        b"\xff",
        b'{"id": 4, "text": ""}',
        b'{"id": 5, "scene": {"lanes": 1e999}, "text": "x"}',
    ]
    done, errors = interpret_lines(lines, scene_of(DEFAULT_SCENE), interpreter, wrote.append)
    assert (done, errors) == (5, 5)
    assert [row["id"] for row in wrote] == ["line-1", "line-2", "line-3", 4, 5]
    assert "longer than" in wrote[0]["error"]


async def closed() -> None:
    pass


NUMBERS = st.one_of(st.integers(), st.floats(), st.just(10**400), st.none(), st.text(max_size=3), st.lists(st.none()))


CARS = st.dictionaries(st.sampled_from(["lane", "gap_m", "speed_mps"]), NUMBERS)


@given(st.dictionaries(st.sampled_from(sorted(SCENE_KEYS)), NUMBERS), st.lists(CARS))
def test_any_scene_is_one_or_says_why_not(value: dict[str, Any], vehicles: list[dict[str, Any]]) -> None:
    with suppress(LineError):
        scene_of({**value, "vehicles": vehicles})


@pytest.mark.parametrize(
    "bad",
    [
        {"lanes": 2, "ego_lane": 5}, {"speed": 3}, {"vehicles": [{}]}, 3, {"lanes": 10**9}, {"lanes": 0},
        {"speed_mps": float("nan")}, {"speed_mps": 1e300}, {"limit_mps": 10**400}, {"ego_lane": float("inf")},
        {"vehicles": [{"gap_m": 10.0, "speed_mps": 20.0}] * 201},
        {"vehicles": [{"lane": 7, "gap_m": 1.0, "speed_mps": 1.0}]},
    ],
)  # fmt: skip
def test_a_scene_that_makes_no_sense_says_why(bad: object) -> None:
    with pytest.raises(LineError, match="scene"):
        scene_of(bad)


def test_the_default_scene_is_the_one_of_the_labels() -> None:
    scene = scene_of(DEFAULT_SCENE)
    assert (len(scene.lanes), scene.ego_lane, scene.speed_mps, scene.limit_mps) == (4, 1, 25.0, 33.0)
    assert scene.lead is not None
    assert scene.lead.gap_m == 40.0


@pytest.mark.parametrize(
    ("slots", "outcome"),
    [
        ({"target_speed_mps": 49.0}, "directive"),
        ({"target_speed_mps": 50.0}, "refused"),
        ({"headway_s": 0.9}, "refused"),
        ({"headway_s": 2.0}, "directive"),
        ({"lane": "rightmost"}, "directive"),
        ({"overtake": False}, "directive"),
        ({"gap": "keep"}, "directive"),
        ({}, "unclear"),
    ],
)
def test_the_road_decides_what_becomes_of_a_wish(slots: dict[str, object], outcome: str) -> None:
    plan = directive_of(Slots.model_validate({"outcome": "directive", **slots}), scene_of(DEFAULT_SCENE))
    assert (plan.outcome if isinstance(plan, Refusal) else "directive") == outcome
    if isinstance(plan, Directive):
        assert plan.target_speed_mps is None or plan.target_speed_mps <= 33.0
        assert plan.target_lane in (None, 1, 3)


def test_replies_are_in_the_passengers_language(parser: IntentParser) -> None:
    rows = interpret(
        "\n".join(
            json.dumps({"id": n, "text": text})
            for n, text in enumerate(("bitte fahr langsamer", "roule moins vite s'il te plaît", "please go slower"))
        )
    )
    assert [row["say"] for row in rows] == [
        sentence("slower", language, speed="83 km/h") for language in ("de", "fr", "en")
    ]


def test_training_commands_are_reproducible_and_labelled() -> None:
    whole = load_stock()
    stock = Stock(whole.frames[::50], whole.words)
    first, second = (Generator(stock, 5).samples(2_000) for _ in range(2))
    assert len(first) == 2_000
    assert first == second
    assert all(sample.label[head] in classes for sample in first for head, classes in HEADS.items())


def test_opposites_that_are_asked_for_together_are_unclear() -> None:
    faster, slower = (
        Frame(text, "en", (("outcome", "directive"), ("speed", speed)), imperative=True)
        for text, speed in (("speed up", "faster"), ("ease off", "slower"))
    )
    stock = Stock([faster, slower, Frame("hm", "en", (("outcome", "unclear"),))], load_stock().words)
    said = {s.text.casefold().rstrip(".!?"): s.label for s in Generator(stock, 0).samples(4_000)}
    for text in ("speed up and ease off at the same time", "ease off while speeding up", "speed up by easing off"):
        assert said[text]["outcome"] == "unclear", text


def test_a_part_of_the_labelled_set_is_the_same_at_every_call_and_has_every_kind() -> None:
    part = labelled_set("dev", 3)
    assert part == labelled_set("dev", 3)
    assert set(Counter(row["kind"] for row in part).values()) == {3}
    assert len({row["kind"] for row in part}) == len({row["kind"] for row in labelled_set("dev")})


def test_memory_is_listed_exported_imported_and_forgotten(tmp_path: Path) -> None:
    bank, line = str(tmp_path / "bank.sqlite"), tmp_path / "learnt.jsonl"
    row = {
        "command": "take the scenic pace",
        "scene": "two-way",
        "slots": {"outcome": "directive", "speed": "slower"},
        "outcome": "fulfilled",
        "took_s": 2.0,
        "min_ttc_s": 1.2,
    }
    line.write_text(json.dumps(row) + "\n")
    assert run.invoke(app, ["memory", "import", str(line), "--bank", bank]).exit_code == 0
    listed = json.loads(run.invoke(app, ["memory", "list", "--json", "--bank", bank]).stdout)
    assert [entry["command"] for entry in listed] == ["take the scenic pace"]
    assert "scenic" in run.invoke(app, ["memory", "show", "a scenic pace", "--bank", bank]).stdout
    exported = json.loads(run.invoke(app, ["memory", "export", "--bank", bank]).stdout)
    assert (exported["took_s"], exported["min_ttc_s"]) == (2.0, 1.2)
    assert run.invoke(app, ["memory", "forget", str(listed[0]["id"]), "--bank", bank]).exit_code == 0
    assert run.invoke(app, ["memory", "forget", str(listed[0]["id"]), "--bank", bank]).exit_code == 1
    line.write_text('{"command": 3}\n')
    assert run.invoke(app, ["memory", "import", str(line), "--bank", bank]).exit_code == 2
