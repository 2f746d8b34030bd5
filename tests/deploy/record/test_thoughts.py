"""Thoughts on record: found, read back and worded; and those of one sentence, explained."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from deploy.cli.app import app
from deploy.record.thoughts import LINE_BYTES, Kept, kept_in, worded
from schemas.runtime.process import CONFIG, FAILED, OK
from schemas.wire.thought import Recalled, Thought, Try, Turn
from slow_node.config import THOUGHTS
from slow_node.thought import ThoughtsFile
from tests.faulty_server import FaultyServer, answer


def thought(command: str = "a bit slower", **more: Any) -> Thought:
    fields: dict[str, Any] = {
        "reading": "directive: heard: speed slower (95% sure)",
        "recalled": (Recalled(command="slow down", similarity=0.87, slots='{"speed":"slower"}', outcome="fulfilled"),),
        "prompt": (Turn(role="system", content="You interpret. " + "x" * 900), Turn(role="user", content=command)),
        "model": "qwen3:8b",
        "tries": (
            Try(ms=310.0, asked="json_schema", failed="HTTP 503: loading model"),
            Try(ms=1200.0, asked="json_object", thinking="Hm.", unusable="it contains no JSON object", finish="stop"),
            Try(ms=900.0, asked="json_object", prompt_tokens=812, answer_tokens=93),
        ),
        "answers": ("Gladly!", '{"outcome":"directive","speed":"slower"}'),
        "guards": ("numbers are those that were said, and no others",),
        "slots": '{"speed":"slower"}',
        "spans_ms": {"parser": 3.0, "model": 2410.0},
        "cost_usd": 0.00042,
    }
    return Thought(
        epoch=1, stamp_ns=1, command_id=1, command=command, source="qwen3:8b", outcome="issued", **{**fields, **more}
    )


def kept(folder: Path, *commands: str) -> Path:
    """A run's folder with these thoughts."""
    folder.mkdir(parents=True)
    file = ThoughtsFile(str(folder / THOUGHTS))
    for command in commands:
        file.write(thought(command))
    return folder


def shown(*arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of `fastslow`."""
    done = CliRunner().invoke(app, arguments)
    return done.exit_code, done.stdout, done.stderr


def test_the_words_tell_what_happened_in_its_order() -> None:
    lines = worded(Kept("2026-11-27T12:00:05.000+00:00", thought()))
    labels = [line[2:12].strip() for line in lines[1:]]
    assert lines[0] == "12:00:05 'a bit slower': issued, by qwen3:8b"
    assert labels == [
        *("read as", "recalled", "to system", "to user"),
        *("asked", "failed", "asked", "thinking", "answer", "unusable", "asked", "answer"),
        *("guard", "taken as", "took"),
    ]
    assert "0.87 'slow down'" in lines[2]
    assert lines[-1].endswith("parser 3 ms, model 2,410 ms; 0.000420 USD")


def test_long_texts_are_shortened_unless_all_is_asked_for() -> None:
    one = Kept("", thought())
    assert max(map(len, worded(one))) < 300
    assert max(map(len, worded(one, full=True))) > 900


def test_words_of_strangers_cannot_forge_a_line() -> None:
    nasty = "x\x1b[2J\n12:00:05 'faster': issued \u009b\u202e"
    lines = worded(Kept("", thought(nasty, guards=(nasty,), answers=(nasty,), model=nasty)))
    assert all(line.isprintable() for line in lines)


def test_the_newest_run_is_shown_and_its_newest_thought_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    old = kept(tmp_path / "runs" / "9-older", "of the older run")
    os.utime(old / THOUGHTS, (1, 1))
    kept(tmp_path / "runs" / "1-newer", "first", "second")
    code, out, _ = shown("thoughts")
    assert code == OK
    assert "of the older run" not in out
    assert out.index("'first'") < out.index("'second'")
    assert "'first'" not in shown("thoughts", "--last", "1")[1]


def test_as_json_nothing_is_lost(tmp_path: Path) -> None:
    folder = kept(tmp_path / "run", "a bit slower")
    code, out, _ = shown("thoughts", str(folder), "--json")
    (row,) = json.loads(out)["thoughts"]
    assert code == OK
    assert len(row["prompt"][0]["content"]) > 900
    assert [one["failed"] for one in row["tries"]] == ["HTTP 503: loading model", "", ""]
    assert row["time"]


def test_a_line_that_was_cut_off_by_a_kill_is_told_and_costs_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = kept(tmp_path / "run", "first", "second") / THOUGHTS
    file.write_bytes(file.read_bytes()[:-200])
    assert [one.thought.command for one in kept_in(file)] == ["first"]
    assert "1 lines" in capsys.readouterr().err


def test_a_line_that_is_too_long_deep_or_no_text_costs_no_other_and_colours_no_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = kept(tmp_path / "run", "\x1b[31mfirst\u202e", "second") / THOUGHTS
    odd = b'{"time": "' + b"x" * LINE_BYTES + b'"}\n' + b"[" * 100_000 + b"\n" + b"\xff\xfe\x00\n" + b"3\n"
    file.write_bytes(odd + file.read_bytes())
    found = kept_in(file)
    assert [one.thought.command for one in found] == ["\x1b[31mfirst\u202e", "second"]
    assert "4 lines" in capsys.readouterr().err
    assert all(line.isprintable() for one in found for line in worded(one, full=True))
    assert [one.thought.command for one in kept_in(file, 1)] == ["second"]


@pytest.mark.parametrize("content", [None, b"no thought\n", b"\xff\xfe\n"])
def test_what_holds_no_thoughts_is_an_error_that_names_what_does(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "x.jsonl"
    if content is not None:
        file.write_bytes(content)
    code, _, err = shown("thoughts", str(file))
    assert code == CONFIG
    assert THOUGHTS in err
    assert err.count("\n") == 1


def test_without_a_run_the_fix_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert shown("thoughts")[0] == CONFIG


FASTER = '<think>Or {"outcome":"directive","speed":"slower"}?</think>{"outcome":"directive","speed":"faster"}'


def test_one_sentence_is_explained_from_its_reading_to_the_reply() -> None:
    with FaultyServer((503, {}, b'{"error":"loading model"}'), answer(FASTER)) as server:
        code, out, _ = shown("interpret", "--explain", "I'm in a hurry", "--base-url", server.url, "--model", "m")
    assert code == OK
    for words in ("read as", "recalled", "loading model", "thinking   Or {", '"speed": "faster"', "says"):
        assert words in out


def test_a_sentence_that_nobody_understood_is_a_failure_with_its_reason() -> None:
    with FaultyServer((404, {}, b'{"error":"model not found, try pulling it first"}')) as server:
        code, out, _ = shown(
            *("interpret", "--explain", "quantum marmalade trombone", "--no-parser", "--json"),
            *("--base-url", server.url, "--model", "m"),
        )
    assert code == FAILED
    thinking = json.loads(out)["thought"]
    assert "try pulling it first" in thinking["tries"][0]["failed"]
