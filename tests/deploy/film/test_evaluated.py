"""Films of evaluated episodes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from deploy.cli.app import app
from deploy.film.evaluated import END_S, Camera, film_row
from deploy.lab.agents import drive
from schemas.driving.road import HZ
from sim_node.results import EpisodeResult
from sim_node.scenarios import SCENARIOS

ffmpeg = pytest.importorskip("imageio_ffmpeg")


def shown(agent: str, scenario: str, seeds: range, scene: int = 0) -> tuple[Camera, list[EpisodeResult]]:
    camera = Camera([scene])
    return camera, drive(agent, SCENARIOS[scenario], seeds, watch=camera)


def test_who_looks_on_changes_nothing_and_sees_the_episode_that_was_counted():
    for agent in ("ours", "random", "idm"):
        camera, seen = shown(agent, "merge", range(1000, 1003), scene=2)
        assert repr(seen) == repr(drive(agent, SCENARIOS["merge"], range(1000, 1003)))
        speeds = [shot.observation for shot in camera.shots[2]][: seen[2].ticks]
        assert len(camera.shots[2]) in (seen[2].ticks, seen[2].ticks + 1)
        assert [o.tick for o in speeds] == list(range(seen[2].ticks))


def test_a_drivers_actions_and_what_closes_them_are_shown_and_nobody_decides_for_idm():
    ours, _ = shown("ours", "merge", range(1000, 1001))
    shots = ours.shots[0]
    assert {shot.action.source for shot in shots if shot.action} >= {"policy", "coordination"}
    assert any(c.reason == "no lane there" for shot in shots if shot.action for c in shot.action.closed)
    idm, _ = shown("idm", "merge", range(1000, 1001))
    assert all(shot.action is None for shot in idm.shots[0])


def test_an_episode_that_ends_in_a_collision_is_shown_to_its_end_and_no_further():
    for seed in range(1000, 1040):
        camera, (result,) = shown("faster", "merge", range(seed, seed + 1))
        if result.collided:
            break
    crashed = [shot.observation.crashed for shot in camera.shots[0]]
    assert crashed == [False] * result.ticks + [True]
    assert sum(1 for _ in camera.pictures(0, "")) == len(crashed) + round(END_S * HZ) - 1


def test_the_first_and_the_worst_by_ride_score_are_filmed_and_named(tmp_path):
    seeds = range(1000, 1004)
    again = partial(drive, "rule", replace(SCENARIOS["highway"], duration_s=3.0), seeds)
    place: dict[str, Any] = {"scenario": "short", "agent": "mine:a/b", "wish_mps": None}
    results = again()
    paths = film_row(tmp_path, {**place, "first_seed": 1000, "directive_at_s": 0.0}, results, again)
    worst = min(zip(seeds, results, strict=True), key=lambda pair: pair[1].ride_score)[0]
    assert worst != 1000
    assert [p.name for p in paths] == ["short-mine-a-b-first-1000.mp4", f"short-mine-a-b-worst-{worst}.mp4"]
    frames, seconds = ffmpeg.count_frames_and_secs(str(paths[1]))
    assert frames >= results[worst - 1000].ticks
    assert seconds == pytest.approx(frames / HZ, abs=0.1)


def test_evaluate_films_what_it_has_counted(tmp_path: Path):
    (tmp_path / "short.toml").write_text('base = "highway"\nduration_s = 1.0\n', encoding="utf-8")
    asked = ["evaluate", "--scenario", str(tmp_path / "short.toml"), "--agent", "rule", "--wish", "22"]
    result = CliRunner().invoke(app, [*asked, "--episodes", "1", "--video", str(tmp_path / "films"), "--json"])
    assert result.exit_code == 0, result.output
    assert [path.name for path in (tmp_path / "films").iterdir()] == ["short-rule-22mps-first-worst-1000.mp4"]


def test_a_language_model_is_not_filmed(tmp_path):
    asked = ["evaluate", "--agent", "dilu-paused", "--scenario", "merge", "--video", str(tmp_path)]
    result = CliRunner().invoke(app, asked)
    assert (result.exit_code, "leave --video out" in result.output) == (2, True)
