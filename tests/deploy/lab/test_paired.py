"""Two checkpoints on the same seeds, and a row per episode."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from deploy.cli.app import app
from deploy.lab.paired import compare
from fast_node.policies.attention import SHIPPED
from fast_node.policies.mlp import shipped


def episodes(agent: str, speeds: dict[int, float]) -> list[dict[str, object]]:
    numbers = dict.fromkeys(("ride_score", "success", "collided", "min_ttc_s", "jerk_rms", "override_share"), 1.0)
    place = {"scenario": "highway", "wish_mps": None, "agent": agent}
    return [{**place, "seed": seed, **numbers, "avg_speed": speed} for seed, speed in speeds.items()]


def test_the_difference_is_taken_seed_by_seed() -> None:
    (row,) = compare(episodes("a", {1: 10.0, 2: 20.0}) + episodes("b", {2: 21.0, 1: 12.0}), "a", "b")
    assert row["avg_speed"] == {"difference": 1.5, "ci95": pytest.approx(12.706 * 0.5), "pairs": 2}
    assert row["success"] == {"difference": 0.0, "ci95": 0.0, "pairs": 2}


def test_an_episode_without_a_number_is_left_out_of_its_difference() -> None:
    (row,) = compare(episodes("a", {1: 10.0, 2: float("nan")}) + episodes("b", {1: 12.0, 2: 21.0}), "a", "b")
    assert row["avg_speed"] == {"difference": 2.0, "ci95": None, "pairs": 1}


def test_two_checkpoints_are_compared_and_every_episode_and_row_is_written(tmp_path: Path) -> None:
    files = ["--checkpoint", str(SHIPPED), "--checkpoint", str(shipped("ppo", "masked"))]
    rows, table = tmp_path / "episodes.csv", tmp_path / "table.csv"
    written_to = ["--rows", str(rows), "--table", str(table)]
    told = CliRunner().invoke(
        app, ["evaluate", *files, "--scenario", "highway", "--episodes", "2", *written_to, "--json"]
    )
    (paired,) = json.loads(told.stdout)["paired"]
    with rows.open(encoding="utf-8") as file:
        written = list(csv.DictReader(file))
    speed = {(row["agent"], row["seed"]): float(row["avg_speed"]) for row in written}
    ours, other = str(SHIPPED), str(shipped("ppo", "masked"))
    assert sorted(speed) == sorted((agent, seed) for agent in (ours, other) for seed in ("1000", "1001"))
    mean = sum(speed[other, seed] - speed[ours, seed] for seed in ("1000", "1001")) / 2
    assert paired["avg_speed"]["difference"] == pytest.approx(mean)
    with table.open(encoding="utf-8") as file:
        assert [(row["agent"], row["success_of"]) for row in csv.DictReader(file)] == [(ours, "2"), (other, "2")]


@pytest.mark.parametrize("more", [["--agent", "rule"], ["--policy", "rule"], ["--checkpoint", str(SHIPPED)]])
def test_two_checkpoints_leave_no_room_for_others(more: list[str]) -> None:
    files = ["--checkpoint", str(SHIPPED), "--checkpoint", str(shipped("ppo", "masked"))]
    assert CliRunner().invoke(app, ["evaluate", *files, *more]).exit_code == 2
