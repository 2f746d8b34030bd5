"""The search for the weights of plans: what it tries, how it moves on, and that it can be gone on with."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fast_node.policies.gaps import DESCRIBED, read_weights
from fast_node.training.plan_weights import CANDIDATES, START, Search, utilities
from schemas.runtime.process import ConfigError


def test_the_best_rank_counts_most_and_all_of_them_add_up_to_nothing() -> None:
    raw = [max(0.0, math.log(3.0) - math.log(rank)) for rank in (1, 2, 3, 4)]  # by the paper's formula, for four
    np.testing.assert_allclose(utilities(4), np.array(raw) / sum(raw) - 0.25)
    assert sum(utilities(CANDIDATES)) == pytest.approx(0.0, abs=1e-12)


def test_candidates_are_pairs_of_opposites_around_the_mean_and_others_each_time() -> None:
    search = Search.begin(1)
    first = search.candidates()
    half = CANDIDATES // 2
    np.testing.assert_allclose(first[:half] + first[half:], np.broadcast_to(2.0 * np.array(search.mean), (half, 12)))
    np.testing.assert_array_equal(first, Search.begin(1).candidates())
    search.tell(np.arange(CANDIDATES, dtype=float))
    assert not np.isclose(search.drawn(), Search.begin(1).drawn()).any()


def test_it_begins_with_the_weights_by_hand() -> None:
    assert dict(zip(DESCRIBED, Search.begin(0).mean, strict=True)) == START


def test_it_finds_the_best_weights_of_a_bowl() -> None:
    search, best = Search.begin(0), np.linspace(-0.5, 1.5, len(DESCRIBED))
    for _ in range(300):
        search.tell(-((search.candidates() - best) ** 2).sum(1))
    np.testing.assert_allclose(search.mean, best, atol=0.05)


def test_one_that_was_stopped_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    path, whole = tmp_path / "plans.json", Search.begin(3)
    for _ in range(4):
        part = Search.resume(path, 3)
        for search in (whole, part):
            search.tell(search.candidates().sum(1))
        part.save(path, {"roads": {"merge": 1}})
    assert part == whole
    np.testing.assert_allclose(read_weights(path), whole.mean, atol=1e-4)


def test_a_file_without_a_search_is_not_gone_on_with(tmp_path: Path) -> None:
    path = tmp_path / "plans.json"
    path.write_text("{}")
    with pytest.raises(ConfigError, match="name another file"):
        Search.resume(path, 0)
