"""`fastslow bench gym`: a row per variant, ratios of the same turn."""

from __future__ import annotations

import pytest

from deploy.bench.gym import VARIANTS, bench_gym, table


@pytest.mark.slow
def test_every_variant_decides_and_the_first_is_compared_with_the_others() -> None:
    result = bench_gym(envs=2, decision_hz=1, seconds=0.1, turns=2, names=("vector", "sync", "stock sync"))
    assert [row["variant"] for row in result["rows"]] == ["vector", "sync", "stock sync"]
    assert result["rows"][0]["first_is_times"] == [1.0, 1.0, 1.0]
    for row in result["rows"]:
        median, least, most = row["first_is_times"]
        assert 0 < least <= median <= most
        assert row["decisions_per_cpu_s"] > 0
    assert table(result).count("\n") == 4


def test_unknown_variants_and_rates_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match=f"envpool: choose from {VARIANTS[0]}"):
        bench_gym(names=["envpool"])
    with pytest.raises(ValueError, match="decision_hz 4 does not divide 15"):
        bench_gym(decision_hz=4)
