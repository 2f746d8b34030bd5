"""The benchmark: its figures by hand-made samples, and one short run of it on the real processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.bench import figures, latency, scale
from deploy.bench.peers import PeerConfig, near_end
from schemas.clock import ManualClock, MonotonicClock
from schemas.codec import rows_of
from schemas.messages import Lane, Observation
from schemas.process import ConfigError
from sim_node.__main__ import REHEARSALS_NS, RehearsingClock

ROOT = Path(__file__).parent.parent


def fastslow(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, "-m", "deploy", *arguments], cwd=cwd, env=env, capture_output=True,
                          text=True, timeout=120, check=False)


def result_of(**took_us: list[float]) -> dict[str, Any]:
    rows = [figures.row_of(what, "none", "15hz", took) for what, took in took_us.items()]
    return {"schema": figures.SCHEMA, "rows": [{f: getattr(row, f) for f in row.__struct_fields__} for row in rows],
            "histograms": {f"{what}/none/15hz": figures.histogram(took) for what, took in took_us.items()}}


def test_a_row_has_the_percentiles_of_its_samples() -> None:
    row = figures.row_of("ours", "none", "15hz", list(range(1, 5002)))
    assert (row.n, row.p50_us, row.p99_us, row.p999_us, row.max_us) == (5001, 2501.0, 4951.0, 4996.0, 5001.0)


@pytest.mark.parametrize(("ticks", "known"), [(2999, False), (3000, True)])
def test_p999_takes_3000_ticks(ticks: int, known: bool) -> None:
    assert (figures.row_of("ours", "none", "15hz", [1.0] * ticks).p999_us is not None) == known


def test_late_and_skipped_ticks_are_misses() -> None:
    assert figures.row_of("ours", "none", "15hz", [19_999.0, 20_001.0], skipped=3).misses == 4


def test_a_histogram_keeps_values_within_one_percent() -> None:
    values, counts = figures.centres(figures.histogram([123.4, 123.4, 45_678.0]))
    assert counts.tolist() == [2, 1]
    assert values == pytest.approx([123.4, 45_678.0], rel=0.01)


def test_a_result_does_not_differ_from_itself() -> None:
    one = result_of(ours=np.random.default_rng(0).lognormal(6, 0.3, 2000).tolist())
    assert not any(row[p]["differ"] for row in figures.compare(one, one) for p in ("p50_us", "p99_us"))


def test_a_result_twice_as_slow_is_told_as_such() -> None:
    took = np.random.default_rng(0).lognormal(6, 0.3, 2000)
    [row] = figures.compare(result_of(ours=took.tolist()), result_of(ours=(2 * took).tolist()))
    assert row["p50_us"]["ratio"] == pytest.approx(2.0, rel=0.01)
    assert row["p50_us"]["differ"]


@pytest.mark.parametrize("content", [None, "nonsense", "[]", '{"schema": "another"}'])
def test_what_is_no_result_cannot_be_compared(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "a.json").write_text(content)
    with pytest.raises(ConfigError, match=r"a\.json"):
        figures.read(tmp_path / "a.json")


class Orders:
    """The benchmark's end of the orders, without a socket."""

    def __init__(self, *orders: object) -> None:
        self._orders: list[object] = [*orders, None]
        self.replies: list[Any] = []

    def recv(self) -> object:
        return self._orders.pop(0)

    def send(self, reply: object) -> None:
        self.replies.append(reply)


def test_a_round_behind_a_late_one_counts_from_when_it_was_due() -> None:
    slow_at = 51  # the rounds before it are for warming up

    def receive() -> bytes:
        nonlocal slow_at
        slow_at -= 1
        if slow_at == 0:
            time.sleep(0.05)
        return b""

    orders = Orders(("paced", time.monotonic_ns() + 50_000_000, 10_000_000, 3))
    near_end(PeerConfig(transport="bus", near=True, folder=""), (lambda _: None, receive), orders)
    took = orders.replies[1][0]
    assert [ns // 10_000_000 >= late for ns, late in zip(took, (5, 4, 3), strict=True)] == [True] * 3


def test_unanswered_and_skipped_ticks_are_found_in_the_stamps(tmp_path: Path) -> None:
    tick = latency.PERIOD_NS
    sim = [(7, 0, 0, 500_000, tick, -1), (7, 1, tick, -1, 2 * tick, 0), (7, 2, 2 * tick, 600_000, 5 * tick, 0)]
    fast = [(7, 0, 100_000, 110_000, 20_000, 30_000, 40_000, 250_000, 300_000)]
    np.array(sim, np.int64).tofile(tmp_path / "sim.trace")
    np.array(fast, np.int64).tofile(tmp_path / "fast.trace")
    samples = latency.Samples()
    latency._read_traces(tmp_path, "none", 0, 10 * tick, samples)
    assert samples.took["ours", "none", "15hz"] == [500.0, tick / 1000.0, 600.0]
    assert samples.skipped["ours", "none", "15hz"] == 2
    assert {name: us for name, [us] in samples.parts["none"].items()} == {
        "bus out": 100.0, "decode": 10.0, "mask": 20.0, "features": 30.0, "policy": 40.0, "rest of the step": 50.0,
        "encode and put": 50.0, "bus back": 200.0}


def test_a_crowd_has_as_many_vehicles_as_asked_for() -> None:
    ego = np.array([[0, 100, 4, 10, 0, 0, 5, 2, 1]], np.float32)
    seen = Observation(epoch=1, stamp_ns=0, tick=0, scenario="two-way", rows=ego.tobytes(),
                       lanes=(Lane(y_m=0.0, start_m=0.0, end_m=1e4), Lane(y_m=4.0, start_m=0.0, end_m=1e4)))
    rows = rows_of(scale.crowd(seen, 50))
    assert len(set(rows[:, 0].tolist())) == len(set(rows[:, 1].tolist())) == 50


def test_a_curve_ends_at_its_knee() -> None:
    points = [{"x": 1, "p99_us": 900.0}, {"x": 2, "p99_us": 25_000.0}, {"x": 4, "breaks": "too large"}]
    assert scale.knee(points) == {"holds": 1, "then": "p99 of 25.0 ms exceeds the deadline"}


class Announced:
    """Counts the announcements."""

    def __init__(self) -> None:
        self.times = 0

    def announce_next(self, _: object) -> None:
        self.times += 1


@pytest.mark.parametrize(("ahead_ns", "times"), [(50_000_000, len(REHEARSALS_NS)), (-1, 0)])
def test_a_tick_is_announced_unless_it_is_late(ahead_ns: int, times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    announced, manual = Announced(), ManualClock()
    monkeypatch.setattr(MonotonicClock, "now_ns", lambda _: manual.now_ns())
    monkeypatch.setattr(MonotonicClock, "sleep_until", lambda _, due_ns: manual.sleep_until(due_ns))
    RehearsingClock(announced).sleep_until(ahead_ns)  # type: ignore[arg-type]
    assert announced.times == times


@pytest.mark.parametrize("mode", ["auto", "fifo", "user", "off"])
def test_scheduling_never_fails(mode: str) -> None:
    code = f"from schemas.realtime import claim; print(claim({mode!r}))"
    done = subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(ROOT)},
                          capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.strip()


@pytest.mark.parametrize("arguments", [
    ("run", "--realtime", "warp"), ("bench", "latency", "--load", "gpu"), ("bench", "latency", "--peer", "carrier")])
def test_what_does_not_exist_is_a_usage_error(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    done = fastslow(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "choose from" in done.stderr


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """One short run on the real processes."""
    folder = tmp_path_factory.mktemp("bench")
    done = fastslow("bench", "latency", "--seconds", "2", "--load", "none", "--peer", "floor", "--peer", "bus",
                    "--peer", "bus-default", "--json", "--out", "out", "--plot", "picture.png", cwd=folder)
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result, folder


def test_every_contender_is_measured_at_both_paces(measured: tuple[dict[str, Any], Path]) -> None:
    assert {(row["what"], row["pace"]) for row in measured[0]["rows"]} == {
        (what, pace) for what in ("floor", "bus", "bus-default", "ours") for pace in ("15hz", "back-to-back")}


def test_a_row_is_what_was_promised(measured: tuple[dict[str, Any], Path]) -> None:
    assert set(measured[0]["rows"][0]) == {
        "what", "load", "pace", "n", "p50_us", "p99_us", "p999_us", "max_us", "misses"}


def test_the_paced_loop_is_measured_at_every_tick(measured: tuple[dict[str, Any], Path]) -> None:
    [ours] = [row for row in measured[0]["rows"] if (row["what"], row["pace"]) == ("ours", "15hz")]
    assert 29 <= ours["n"] + measured[0]["loads"]["none"]["skipped_ticks"] <= 31


def test_the_parts_of_a_tick_are_all_there(measured: tuple[dict[str, Any], Path]) -> None:
    assert all(part["p50"] > 0 for part in measured[0]["parts_us"]["none"].values())


def test_the_saved_result_can_be_compared(measured: tuple[dict[str, Any], Path]) -> None:
    saved = str(measured[1] / "out" / "latency.json")
    done = fastslow("bench", "compare", saved, saved, "--json", cwd=measured[1])
    assert all(row["p50_us"]["ratio"] == 1.0 for row in json.loads(done.stdout)["rows"])


def test_the_picture_is_drawn(measured: tuple[dict[str, Any], Path]) -> None:
    assert (measured[1] / "picture.png").read_bytes().startswith(b"\x89PNG")
