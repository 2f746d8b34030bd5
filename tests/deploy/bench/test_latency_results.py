"""The rows and histograms of a latency run, and two of them compared."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from deploy.bench import latency_results
from deploy.cli.bench import app
from schemas.runtime.process import ConfigError


def result_of(**took_us: list[float]) -> dict[str, Any]:
    rows = [latency_results.row_of(what, "none", "15hz", took) for what, took in took_us.items()]
    return {
        "schema": latency_results.SCHEMA,
        "rows": [{f: getattr(row, f) for f in row.__struct_fields__} for row in rows],
        "histograms": {f"{what}/none/15hz": latency_results.histogram(took) for what, took in took_us.items()},
    }


def test_a_row_has_the_percentiles_of_its_samples() -> None:
    row = latency_results.row_of("ours", "none", "15hz", list(range(1, 5002)))
    assert (row.n, row.p50_us, row.p90_us, row.p99_us, row.p999_us, row.max_us) == (
        5001,
        2501.0,
        4501.0,
        4951.0,
        4996.0,
        5001.0,
    )


@pytest.mark.parametrize(("ticks", "known"), [(2999, False), (3000, True)])
def test_p999_takes_3000_ticks(ticks: int, known: bool) -> None:
    assert (latency_results.row_of("ours", "none", "15hz", [1.0] * ticks).p999_us is not None) == known


def test_late_and_skipped_ticks_are_misses() -> None:
    assert latency_results.row_of("ours", "none", "15hz", [19_999.0, 20_001.0], skipped=3).misses == 4


def test_a_histogram_keeps_values_within_one_percent() -> None:
    values, counts = latency_results.centres(latency_results.histogram([123.4, 123.4, 45_678.0]))
    assert counts.tolist() == [2, 1]
    assert values == pytest.approx([123.4, 45_678.0], rel=0.01)


def test_a_result_does_not_differ_from_itself() -> None:
    one = result_of(ours=np.random.default_rng(0).lognormal(6, 0.3, 2000).tolist())
    compared = latency_results.compare(one, one)
    assert [row[p]["differ"] for row in compared["rows"] for p in ("p50_us", "p99_us")] == [False, False]
    assert (compared["only_a"], compared["only_b"], compared["hosts"]) == ([], [], {})


def test_a_result_twice_as_slow_is_told_as_such() -> None:
    took = np.random.default_rng(0).lognormal(6, 0.3, 2000)
    [row] = latency_results.compare(result_of(ours=took.tolist()), result_of(ours=(2 * took).tolist()))["rows"]
    assert row["p50_us"]["ratio"] == pytest.approx(2.0, rel=0.01)
    assert row["p50_us"]["differ"]
    assert row["max_us"]["b"] == pytest.approx(2 * row["max_us"]["a"], abs=0.2)


def test_what_makes_two_results_incomparable_is_said() -> None:
    one, other = result_of(ours=[1.0, 30_000.0], zmq=[1.0]), result_of(ours=[1.0, 2.0], dora=[1.0])
    one["host"], other["host"] = ({"realtime": mode, "cpu": "same", "cores": 2} for mode in ("fifo", "user"))
    said = list(latency_results.compared(latency_results.compare(one, other)))
    assert said[0] == "not the same realtime: fifo and user"
    assert "p99.9 - -> -   max 30000 -> 2   misses 1 -> 0" in said[1]
    assert said[2:4] == ["only in a: zmq/none/15hz", "only in b: dora/none/15hz"]


def test_results_without_a_common_row_are_an_error(tmp_path: Path) -> None:
    for name in ("zmq", "dora"):
        (tmp_path / name).write_text(json.dumps(result_of(**{name: [1.0]})))
    done = CliRunner().invoke(app, ["compare", str(tmp_path / "zmq"), str(tmp_path / "dora")])
    assert done.exit_code == 1
    assert "no row in common" in done.output


def test_a_result_without_histograms_names_the_file_to_take(tmp_path: Path) -> None:
    printed = result_of(ours=[1.0])
    del printed["histograms"]
    (tmp_path / "a.json").write_text(json.dumps(printed))
    with pytest.raises(ConfigError, match=r"latency\.json that the run saved"):
        latency_results.read(tmp_path / "a.json")


@pytest.mark.parametrize("content", [None, "nonsense", "[]", '{"schema": "another"}'])
def test_what_is_no_result_cannot_be_compared(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "a.json").write_text(content)
    with pytest.raises(ConfigError, match=r"a\.json"):
        latency_results.read(tmp_path / "a.json")
