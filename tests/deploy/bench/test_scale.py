"""How far the loop scales: vehicles, egos, simulators, message sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.bench import latency_samples, scale, scale_fast_node, scale_simulators
from deploy.bench.scale_points import breaking_point
from schemas.wire.codec import rows_of
from tests.scenes import HIGHWAY, car, observation


def test_a_crowd_has_as_many_vehicles_as_asked_for() -> None:
    rows = rows_of(scale_fast_node.crowd(observation(car(0, 100, 1, 10), lanes=HIGHWAY[:2]), 50))
    assert len(set(rows[:, 0].tolist())) == len(set(rows[:, 1].tolist())) == 50


@pytest.mark.parametrize(
    ("beyond", "why"),
    [
        ({"x": 2, "n": 9, "p99_us": 25_000.0}, "p99 of 25.0 ms exceeds the deadline"),
        ({"x": 2, "n": 9, "p99_us": 900.0, "misses": 3}, "3 of 9 ticks missed"),
        ({"x": 2, "breaks": "too large"}, "too large"),
    ],
)
def test_the_knee_is_the_first_point_that_does_not_hold(beyond: dict[str, Any], why: str) -> None:
    points = [{"x": 1, "n": 9, "p99_us": 900.0, "misses": 0}, beyond, {"x": 4, "n": 9, "p99_us": 900.0}]
    assert breaking_point(points) == {"holds": 1, "breaks_at": 2, "then": why}


def test_the_largest_number_of_egos_is_found_between_two_that_were_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale_fast_node, "_egos", lambda _, n, __: {"x": n, "n": 1, "p99_us": 20_000.0 * n / 45})
    holds = breaking_point(scale_fast_node.egos(None, 1))["holds"]  # type: ignore[arg-type]
    assert 43 <= holds <= 45


def test_unanswered_ticks_last_their_period_and_skipped_ones_are_counted(tmp_path: Path) -> None:
    tick = latency_samples.PERIOD_NS
    stamps = [
        (7, 0, 0, 500, 0, 1, tick, tick, -1),
        (7, 1, tick, -1, tick, tick + 1, 2 * tick, 2 * tick, 0),
        (7, 2, 2 * tick, 600, 2 * tick, 2 * tick + 1, 5 * tick, 5 * tick, 0),
    ]
    np.array(stamps, np.int64).tofile(tmp_path / "0.trace")
    assert scale_simulators._round_trips(tmp_path / "0.trace", 0, 10 * tick) == ([500, tick, 600], 2)


@pytest.mark.parametrize("direct", [True, False])
@pytest.mark.realtime
def test_two_simulators_on_one_bus_are_answered_by_their_own_fast_nodes(tmp_path: Path, direct: bool) -> None:
    point = scale_simulators._pairs(tmp_path, "auto", 1.0, 2, direct=direct)
    assert 28 <= point["n"] <= 32
    assert point["misses"] < point["n"] / 2


@pytest.mark.realtime
def test_a_message_of_64_kib_is_lost_on_the_low_latency_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scale, "SIZES", (1024, 65_536))
    assert breaking_point(scale.sizes(tmp_path, "off", 10)) == {
        "holds": 1024,
        "breaks_at": 65_536,
        "then": "lost without an error: the low-latency transport does not fragment",
    }


def test_the_curves_are_drawn(tmp_path: Path) -> None:
    points: list[dict[str, Any]] = [{"x": 1, "n": 9, "p50_us": 500.0, "p99_us": 900.0}, {"x": 2, "breaks": "too large"}]
    curve = {"points": points, "knee": breaking_point(points)}
    scale.plot({"curves": {"vehicles": curve, "egos": curve}}, tmp_path / "scale.png")
    assert (tmp_path / "scale.png").read_bytes().startswith(b"\x89PNG")
