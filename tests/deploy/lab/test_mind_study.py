"""`study --mind`: a passenger in lock-step, whose answers come as late as they are told to, the same every time."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from deploy.lab.cached_model import CachedModel, kept_in
from deploy.lab.rider import Heard, Ridden, Rider, Wish, question, ride, scene_at
from deploy.lab.study import mind
from fast_node.policies.load import load_policy
from fast_node.policies.policy import NamedPolicy
from schemas.runtime.process import ConfigError
from schemas.wire.program import Program, Step
from slow_node.evaluation.score import exam_texts, plain_text
from slow_node.interpretation import Interpretation
from slow_node.llm.errors import ModelError
from slow_node.understanding.slots import Slots
from tests.faulty_server import FaultyServer, answer

EIGHTEEN = Step(act="drive", value=18.0, unit="mps")
WISH = Wish("highway", "eighteen metres a second", (EIGHTEEN,))
UNDERSTOOD = Interpretation(
    Slots(outcome="directive", target_speed_mps=18.0),
    program=Program(outcome="directive", steps=(EIGHTEEN,)),
    verdict="decided",
)
NOTHING = Interpretation(Slots(outcome="out_of_scope"), program=Program(outcome="out_of_scope"))


@pytest.fixture(scope="module")
def policy() -> NamedPolicy:
    return load_policy()


def ridden(policy: NamedPolicy, *heard: Heard, wish: Wish = WISH, duration_s: float = 12.0) -> Ridden:
    rider = Rider(wish, 1.0, lambda _: heard, asks_again=False)
    return ride(wish, rider, policy, seed=7000, at_s=1.0, duration_s=duration_s)


def test_what_is_understood_later_is_done_later_and_nothing_where_nobody_listens(policy: NamedPolicy) -> None:
    soon, late, never = (ridden(policy, (s, UNDERSTOOD)) for s in (0.1, 4.0, 60.0))
    assert (soon.success, late.success, never.success) == (True, True, False)
    assert soon.compliance > late.compliance > never.compliance == 0.0
    assert (soon.directives, never.directives) == (1, 0)


def test_the_same_drive_comes_out_the_same(policy: NamedPolicy) -> None:
    assert ridden(policy, (2.0, UNDERSTOOD), duration_s=5.0) == ridden(policy, (2.0, UNDERSTOOD), duration_s=5.0)


def test_a_verdict_that_comes_later_takes_the_readers_directive_back(policy: NamedPolicy) -> None:
    reader = Interpretation(UNDERSTOOD.slots, program=UNDERSTOOD.program, provisional=True)
    withdrawn = Interpretation(NOTHING.slots, program=NOTHING.program, verdict="withdrew")
    assert ridden(policy, (0.1, reader), (0.5, withdrawn), duration_s=3.0).directives == 2


def test_what_asks_for_nothing_succeeds_where_nothing_is_done(policy: NamedPolicy) -> None:
    dinner = Wish("highway", "what is for dinner")
    assert ridden(policy, (0.1, NOTHING), wish=dinner, duration_s=3.0).success
    assert not ridden(policy, (0.1, UNDERSTOOD), wish=dinner, duration_s=3.0).success


def test_its_commands_are_in_no_labelled_set() -> None:
    assert not {plain_text(wish.text) for wish in mind.WISHES} & exam_texts()


def test_the_question_that_is_asked_beforehand_is_the_one_of_the_drive(policy: NamedPolicy) -> None:
    asked: list[Any] = []
    rider = Rider(WISH, 1.0, lambda one: asked.append(one) or [], asks_again=False)  # type: ignore[func-returns-value]
    ride(WISH, rider, policy, seed=7000, at_s=1.0, duration_s=2.0)
    before = question(WISH, scene_at("highway", 7000, policy, 1.0))
    assert (asked[0].command, asked[0].scene, asked[0].context) == (before.command, before.scene, before.context)


def test_every_row_of_the_table_is_driven_without_and_with_every_delay_and_each_part_left_out() -> None:
    rows = [(one.driver, one.delay_s, one.without) for one in mind.conditions(endpoint=True, told=True)]
    assert len(rows) == len(set(rows)) == 1 + 4 * 5 + 2 * 2
    assert {driver for driver, _, _ in rows} == set(mind.DRIVERS)


def test_nothing_is_left_out_of_a_prompt_that_has_the_command_alone() -> None:
    left_out = [one.driver for one in mind.conditions(endpoint=True, told=False) if one.without]
    assert left_out == ["endpoint", "endpoint"]


def test_an_answer_is_asked_for_once_and_a_failure_again(tmp_path: Path) -> None:
    kept = tmp_path / "answers.jsonl"
    chat = [{"role": "user", "content": "hello"}]

    def asked(url: str, salt: str = "") -> str:
        model = CachedModel(url, "m", "", path=kept, salt=salt)

        async def run() -> str:
            try:
                return await model.complete(chat, None, 20.0)
            finally:
                await model.close()

        return asyncio.run(run())

    with FaultyServer((401, {}, b""), answer("one"), answer("two")) as server:
        with pytest.raises(ModelError):
            asked(server.url)
        assert [asked(server.url), asked(server.url), asked(server.url, "another adapter")] == ["one", "one", "two"]
    assert len([json.loads(line) for line in kept.read_text().splitlines()]) == 2


def test_an_answer_that_was_interrupted_while_it_was_written_is_asked_for_again(tmp_path: Path) -> None:
    kept = tmp_path / "answers.jsonl"
    whole = json.dumps({"key": "a", "text": "\u2028 one", "probability": None}, ensure_ascii=False) + "\n"
    kept.write_text(whole + '{"key": "b", "te', "utf-8")
    assert set(CachedModel("http://127.0.0.1:9/v1", "m", "", path=kept)._known) == {"a"}
    assert kept.read_text("utf-8") == whole  # the next row begins a line


def test_answers_with_another_adapter_are_kept_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    adapter = tmp_path / "adapter.gguf"
    monkeypatch.setattr("deploy.lab.cached_model.ADAPTER", adapter)

    def salt() -> str:
        return kept_in(tmp_path / "answers.jsonl")("http://127.0.0.1:9/v1", "m", "")._salt

    assert salt() == ""
    adapter.write_bytes(b"one")
    one = salt()
    adapter.write_bytes(b"another")
    assert len({"", one, salt()}) == 3


def test_a_file_of_somebody_else_is_not_gone_on_with_and_stays_as_it_is(tmp_path: Path) -> None:
    kept = tmp_path / "answers.jsonl"
    kept.write_text("my notes\n")
    with pytest.raises(ConfigError, match="holds something else; move it away"):
        CachedModel("http://127.0.0.1:9/v1", "m", "", path=kept)
    assert kept.read_text() == "my notes\n"
