"""How a command was understood: whole in a file, and within the bounds of its topic on the bus."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from schemas.wire.codec import decode, encode
from schemas.wire.thought import Thought
from schemas.wire.topics import THOUGHT
from slow_node.llm.answer import Answer
from slow_node.llm.model import Call
from slow_node.memory.bank import Example
from slow_node.thought import ThoughtsFile, Trace, shortened, thought_of
from slow_node.understanding.slots import Slots

SLOTS = Slots(outcome="directive", speed="faster")


def thought(trace: Trace, command: str = "faster") -> Thought:
    return thought_of(
        trace, epoch=1, stamp_ns=1, command_id=3, command=command, source="m", outcome="issued", slots=SLOTS
    )


def calls(*texts: str) -> list[Call]:
    return [Call(0.0, 12.345, "json_schema", Answer(text, thinking=text, finish="stop")) for text in texts]


@pytest.mark.parametrize("letter", ["x", "ü", "界", "🚗", "\ud800"])
@pytest.mark.parametrize("turns", [2, 18, 60])
def test_a_thought_is_small_enough_to_be_sent_whatever_was_thought(letter: str, turns: int) -> None:
    long = letter * 5000
    slots = Slots(outcome="directive", reasoning="x" * 400, say="ü" * 300)
    trace = Trace(
        reading=long,
        nearest=(Example(long, long, slots, outcome=long, cosine=0.9),) * 8,
        prompt=[{"role": "user", "content": long}] * turns,
        calls=[*calls(*[long] * 9), Call(0.0, 1.0, "text", error=long)],
        answers=[long] * 3,
        parses=[long] * 9,
        guards=[long] * 5,
        spans_ms={"parser": 1.0, "memory": 2.0, "model": 3.0},
        model=long,
    )
    message = shortened(thought(trace, long))
    assert message.trimmed
    assert decode(THOUGHT, encode(message)) == message


def test_what_fits_is_left_as_it_is() -> None:
    prompt = [{"role": "system", "content": "s" * 4000}, {"role": "user", "content": "faster"}]
    answer = '{"outcome":"directive"}'
    whole = thought(Trace(prompt=prompt, answers=[answer], calls=calls(answer), spans_ms={"model": 812.345}))
    assert shortened(whole) == whole
    assert (whole.spans_ms, whole.tries[0].ms, whole.trimmed) == ({"model": 812.35}, 12.35, False)


def test_a_long_text_is_cut_before_a_short_one() -> None:
    prompt = [{"role": "system", "content": "s" * 20_000}, {"role": "user", "content": "the very words"}]
    message = shortened(thought(Trace(prompt=prompt)))
    assert message.prompt[1].content == "the very words"
    assert 11_000 < len(message.prompt[0].content) < 12_500


def test_each_try_has_what_came_of_it() -> None:
    """Overloaded at first, then prose, then an answer."""
    prose, good = calls("Gladly!", '{"outcome":"unclear"}')
    trace = Trace(calls=[Call(0.0, 5.0, "json_schema", error="HTTP 503"), prose, good], parses=["no JSON object", ""])
    assert [(one.failed, one.unusable, one.thinking) for one in thought(trace).tries] == [
        ("HTTP 503", "", ""),
        ("", "no JSON object", "Gladly!"),
        ("", "", '{"outcome":"unclear"}'),
    ]


def test_the_file_has_every_thought_whole(tmp_path: Path) -> None:
    file = ThoughtsFile(str(tmp_path / "thoughts.jsonl"))
    whole = thought(Trace(prompt=[{"role": "system", "content": "s" * 20_000}]), "schneller\nbitte \ud800")
    file.write(whole)
    file.write(whole)
    lines = (tmp_path / "thoughts.jsonl").read_text("utf-8").splitlines()
    assert [len(json.loads(line)["prompt"][0]["content"]) for line in lines] == [20_000, 20_000]


def test_the_file_and_the_one_before_it_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slow_node.thought.FILE_BYTES", 5000)
    file = ThoughtsFile(str(tmp_path / "thoughts.jsonl"))
    for _ in range(200):
        file.write(thought(Trace()))
    sizes = [path.stat().st_size for path in tmp_path.iterdir()]
    assert len(sizes) == 2
    assert max(sizes) < 6000


def test_a_file_that_cannot_be_written_is_told_once_and_costs_nothing_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = ThoughtsFile(str(tmp_path / "no such folder" / "thoughts.jsonl"))
    file.write(thought(Trace()))
    file.write(thought(Trace()))
    assert capsys.readouterr().err.count("no thought is kept") == 1
