"""`fastslow bench passenger`: the ten commands, said to the real processes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from deploy.bench.passenger import COMMANDS, NODES, lines, measure
from schemas.wire.messages import Directive, Reply
from slow_node.llm.embedding import load_embedder
from slow_node.understanding.intent_parser import IntentParser
from tests.scripted import model_of

ANSWERS: tuple[dict[str, object], ...] = (
    {"overtake": True},
    {"speed": "slower"},
    {"outcome": "refused"},
    {"lane": "rightmost"},
    {"outcome": "out_of_scope"},
    {"target_speed_mps": 25.0, "language": "de"},
    {"gap": "farther"},
    {"outcome": "unclear"},
    {"speed": "faster"},
    {"cancel": True},
)
"""A language model's to the ten commands."""


def answered(prompt: str) -> str:
    number = max(range(len(COMMANDS)), key=lambda n: prompt.rfind(COMMANDS[n].text))  # examples stand before it
    return json.dumps({"reasoning": "scripted", "outcome": "directive", **ANSWERS[number]})


@pytest.fixture(params=["embedded", "endpoint"])
def model_env(request: pytest.FixtureRequest) -> Iterator[dict[str, str]]:
    with model_of(request.param, answered, len(COMMANDS) - 1) as env:  # the rules refuse one by themselves
        yield env


@pytest.mark.timeout(90)
@pytest.mark.realtime
def test_the_ten_commands_go_as_expected_on_the_running_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, model_env: dict[str, str]
) -> None:
    if IntentParser.load(load_embedder()) is None:
        pytest.skip("MiniLM or the parser's weights are not installed")
    monkeypatch.chdir(tmp_path)
    result = measure(tmp_path, spacing_s=0.3, without=("llm",), model_env=model_env)
    assert [row["text"] for row in result["rows"] if not row["as_expected"]] == []
    assert (result["heard_s"]["n"], result["decided_s"]["n"], len(result["rss_mb"])) == (10, 10, len(NODES))
    assert "10 of 10 as expected" in list(lines(result))


@pytest.mark.parametrize("number", range(len(COMMANDS)))
def test_a_wrong_outcome_is_not_taken_for_the_expected_one(number: int) -> None:
    stop = Directive(epoch=0, stamp_ns=0, id=1, command_id=1, scene_tick=0, manoeuvre="stop", target_speed_mps=0.0)
    issued = Reply(epoch=0, stamp_ns=0, command_id=1, outcome="issued", text="", say="I will stop.", directive_id=1)
    failed = Reply(epoch=0, stamp_ns=0, command_id=1, outcome="failed", text="", why="the model cannot be reached")
    assert not COMMANDS[number].fits(issued, stop)
    assert not COMMANDS[number].fits(failed, None)
