"""Learning the weights of plans: real episodes, and a file by which the car drives."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from deploy.lab import plan_learning
from deploy.lab.plan_learning import Road, learn, worth
from fast_node.training.plan_weights import Search

SHORT = (Road("merge", 2),)


def test_a_generation_leaves_weights_that_drive_and_the_next_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(plan_learning, "ROADS", SHORT)
    path = tmp_path / "runs" / "plans.json"
    learn(path, 1, 0)
    after_one = Search.resume(path, 0)
    learn(path, 2, 0)
    assert (after_one.generation, Search.resume(path, 0).generation) == (1, 2)
    assert msgspec.json.decode(path.read_bytes())["roads"] == {"merge": 2}
    assert 0.0 < worth(f"gaps:{path}", 0) <= 100.0
    assert "2/2 ride score" in capsys.readouterr().err
