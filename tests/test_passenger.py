"""`fastslow bench passenger`: the ten commands, said to the real processes."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.bench.passenger import COMMANDS, NODES, lines, measure
from schemas.messages import Directive, Reply
from slow_node.embedding import load_embedder
from slow_node.reader import Reader


@pytest.mark.timeout(90)
def test_the_ten_commands_go_as_expected_on_the_running_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if Reader.load(load_embedder()) is None:
        pytest.skip("MiniLM or the reader's weights are not installed")
    monkeypatch.chdir(tmp_path)
    result = measure(tmp_path, spacing_s=0.3, without=("llm",))
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
