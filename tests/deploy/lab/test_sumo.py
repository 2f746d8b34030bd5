"""Evaluation in SUMO's traffic: the same table, other drivers in the other cars."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from deploy.cli.app import app
from deploy.lab.agents import drive
from deploy.lab.episodes import Step
from deploy.lab.evaluate import evaluate_all
from fast_node.training.rollout import Driver, Fleet
from sim_node.scenarios import SCENARIOS

libsumo = pytest.importorskip("libsumo")
MERGE = SCENARIOS["merge-natural"]


def test_ours_and_sumo_s_own_driver_merge_without_a_collision():
    result = evaluate_all(["ours", "sumo-eidm"], ["merge-natural"], 2, sim="sumo")
    assert [row["sim"] for row in result["rows"]] == ["sumo", "sumo"]
    for row in result["rows"]:
        assert row["success"] == 1.0
        assert row["ego_fault_collisions"] == row["struck_collisions"] == 0


def test_an_episode_is_that_of_its_seed_however_many_are_driven():
    second = drive("ours", MERGE, range(1000, 1002), sim="sumo")[1]
    (alone,) = drive("ours", MERGE, [1001], sim="sumo")
    assert (second.ticks, second.progress_m) == (alone.ticks, alone.progress_m)


def test_a_drive_that_fails_leaves_no_world_of_sumo_behind():
    def fails(fleet: Fleet, driver: Driver | None, step: Step) -> Step:
        assert libsumo.simulation.isLoaded()
        raise RuntimeError("who looks on has failed")

    with pytest.raises(RuntimeError, match="who looks on"):
        drive("ours", MERGE, [1000], sim="sumo", watch=fails)
    assert not libsumo.simulation.isLoaded()


def test_who_drives_and_where_is_told_where_it_does_not_exist():
    with pytest.raises(ValueError, match="idm is highway-env's: in SUMO there are sumo-krauss, sumo-eidm"):
        drive("idm", MERGE, [1000], sim="sumo")
    with pytest.raises(ValueError, match="'sumo-eidm' is not one of"):
        drive("sumo-eidm", MERGE, [1000])
    with pytest.raises(ValueError, match="'carla' is not one of: highway-env, sumo"):
        drive("ours", MERGE, [1000], sim="carla")


@pytest.mark.parametrize("command", ["run", "evaluate"])
def test_another_simulator_s_name_is_refused_in_one_line(command: str):
    done = CliRunner().invoke(app, [command, "--sim", "carla"])
    assert done.exit_code == 2
    assert "carla" in done.output
