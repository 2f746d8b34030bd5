"""The search for the weights of plans: what it tries, how it moves on, and that it can be gone on with."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fast_node.policies.gaps import GAPS
from fast_node.training.plan_weights import CANDIDATES, Search, utilities
from schemas.runtime.process import ConfigError

NAMES = GAPS.names


def begun(seed: int) -> Search:
    return Search({name: float(k) for k, name in enumerate(NAMES)}, dict.fromkeys(NAMES, 0.2), 0, seed)


def test_the_best_rank_counts_most_and_all_of_them_add_up_to_nothing() -> None:
    raw = [max(0.0, math.log(3.0) - math.log(rank)) for rank in (1, 2, 3, 4)]  # by the paper's formula, for four
    np.testing.assert_allclose(utilities(4), np.array(raw) / sum(raw) - 0.25)
    assert sum(utilities(CANDIDATES)) == pytest.approx(0.0, abs=1e-12)


def test_candidates_are_pairs_of_opposites_around_the_mean_and_others_each_time() -> None:
    search, half = begun(1), CANDIDATES // 2
    first = search.candidates()
    assert len(first) == CANDIDATES
    for one, other in zip(first[:half], first[half:], strict=True):
        assert {name: (one[name] + other[name]) / 2.0 for name in NAMES} == pytest.approx(search.weights)
    assert first == begun(1).candidates()
    search.tell(np.arange(CANDIDATES, dtype=float))
    assert not np.isclose(search.drawn(), begun(1).drawn()).any()


def test_it_finds_the_best_weights_of_a_bowl() -> None:
    search, best = begun(0), np.linspace(-0.5, 1.5, len(NAMES))
    for _ in range(400):
        tried = np.array([[one[name] for name in NAMES] for one in search.candidates()])
        search.tell(-((tried - best) ** 2).sum(1))
    np.testing.assert_allclose([search.weights[name] for name in NAMES], best, atol=0.05)


def test_one_that_was_stopped_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    path, whole = tmp_path / "plans.json", begun(3)
    for _ in range(4):
        part = begun(3).resume(path)
        for search in (whole, part):
            search.tell(np.array([sum(one.values()) for one in search.candidates()]))
        part.save(path, {"roads": {"merge": 1}})
    assert part == whole
    np.testing.assert_allclose(GAPS.read(path), [whole.weights[name] for name in NAMES])


@pytest.mark.parametrize("content", ["{}", '{"weights": {"open": 1.0}, "widths": {"open": 0.1}}'])
def test_a_file_without_a_search_of_these_weights_is_not_gone_on_with(tmp_path: Path, content: str) -> None:
    path = tmp_path / "plans.json"
    path.write_text(content)
    with pytest.raises(ConfigError, match="name another file"):
        begun(0).resume(path)
