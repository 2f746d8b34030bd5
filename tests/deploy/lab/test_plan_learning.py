"""Learning the weights of plans: real episodes, and a file by which the car drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from deploy.lab import plan_learning
from deploy.lab.plan_learning import SUBJECTS, Road, learn, worth
from fast_node.policies.courses import COURSES
from fast_node.policies.gaps import GAPS
from fast_node.policies.weights import Described
from fast_node.training import plan_weights
from fast_node.training.plan_weights import Search

SHORT = (Road("merge", 2),)


@pytest.mark.parametrize("what", SUBJECTS)
def test_a_generation_leaves_weights_that_drive_and_the_next_goes_on(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    subject = SUBJECTS[what]
    begun = Search(subject.start, subject.widths)
    monkeypatch.setitem(plan_learning.SUBJECTS, what, replace(subject, roads=SHORT))
    monkeypatch.setattr(plan_weights, "CANDIDATES", 4)
    path = tmp_path / "runs" / "weights.json"
    learn(what, path, 1, 0)
    after_one = begun.resume(path)
    learn(what, path, 2, 0)
    assert (after_one.generation, begun.resume(path).generation) == (1, 2)
    assert msgspec.json.decode(path.read_bytes())["roads"] == [{"name": "merge", "episodes": 2, "directive": "hurry"}]
    assert 0.0 < worth(f"{what}:{path}", SHORT, 0) <= 100.0
    assert "2/2 ride score" in capsys.readouterr().err


@pytest.mark.parametrize(("what", "described"), [("gaps", GAPS), ("courses", COURSES)])
def test_a_search_begins_with_every_weight_of_the_plans(what: str, described: Described) -> None:
    subject = SUBJECTS[what]
    assert list(subject.start) == list(subject.widths) == list(described.names)
