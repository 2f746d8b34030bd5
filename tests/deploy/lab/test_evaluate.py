"""Evaluation: many scenes at once drive as the node drives one, and the numbers are what they are called."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from deploy.cli.app import app
from deploy.lab import evaluate, report
from deploy.lab.agents import AGENTS, drive
from deploy.lab.episodes import by_the_tick, task_of, way_is_open
from deploy.lab.evaluate import SCHEMA, evaluate_all
from deploy.lab.statistics import wilson95
from fast_node.config import FastConfig
from fast_node.mask import OPEN, REAR_GAP
from fast_node.node import FastNode
from fast_node.policies.attention import SHIPPED, load_attention
from fast_node.policies.fixed import ConstantPolicy
from fast_node.policies.load import load_policy
from fast_node.policies.mlp import BASELINES, VARIANTS, load_mlp, shipped
from fast_node.training.rollout import Driver, Fleet
from schemas.driving.intent import ANY_LANE, unasked_lane
from schemas.driving.road import DECISION_TICKS, VX, VY, X, Y
from schemas.runtime.process import ConfigError
from schemas.wire.messages import Directive, MetaAction
from sim_node.config import SimConfig
from sim_node.engine.batched import Batched
from sim_node.metrics import Recorder
from sim_node.node import SimNode
from sim_node.results import summarise
from sim_node.scenarios import SCENARIOS
from sim_node.scenarios.scenario import streams
from tests.scenes import car


@pytest.mark.parametrize(("name", "seed"), [("highway", 1000), ("merge", 1004), ("two-way", 1005), ("roadworks", 1004)])
def test_many_scenes_drive_tick_by_tick_as_the_node_drives_one(name: str, seed: int) -> None:
    scenario, policy = SCENARIOS[name], load_policy()
    world = Batched(scenario, 1, 0)
    world.load(0, scenario.spawn(streams(seed)[0]))
    fleet = Fleet(world, task_of(scenario))
    top = scenario.ego.speed_ceiling_mps
    fleet.v_des[0], fleet.headway[0] = top, 1.5
    overtakes = not scenario.wish_lanes
    fleet.told_lane[0], fleet.pass_id[0] = (1, 1) if overtakes else (ANY_LANE, -1)
    driver = Driver(fleet, policy.logits)

    sim, fast = SimNode(SimConfig(scenario=name, seed=seed)), FastNode(FastConfig(), policy)
    sim.reset(1)
    seen = sim.observation(0)
    told = Directive(
        epoch=1,
        stamp_ns=0,
        id=1,
        command_id=1,
        scene_tick=0,
        target_speed_mps=top,
        headway_s=1.5,
        manoeuvre="overtake" if overtakes else "cruise",
        ttl_s=999.0,
    )
    compared = 0
    for tick in range(150):
        if not overtakes:
            fleet.told_lane[0] = unasked_lane(
                fleet.lanes[0],
                int(world.target_lane[0]),
                int(world.previous_lane[0]),
                float(world.rows[0, 0, X]),
                float(world.rows[0, 0, VX]),
            )
        driver.tick()
        action, events = fast.step(seen, told, 0)
        if overtakes and any(e.kind == "fulfilled" for e in events):
            break  # what this fleet is told ends with the pass
        assert action.meta_action == driver.meta[0], tick
        seen = sim.step(action, 0)
        assert seen.rows[4:24] == world.rows[0, 0, 1:6].tobytes(), tick
        compared += 1
    assert compared >= 60


def test_the_rule_behind_the_mask_never_collides_and_doing_nothing_mostly_does() -> None:
    seeds = range(1000, 1030)
    for name in ("highway", "merge", "two-way"):
        assert not any(r.collided for r in drive("rule", SCENARIOS[name], seeds))
        assert np.mean([r.collided for r in drive("cruise", SCENARIOS[name], seeds)]) > 0.5


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.slow
def test_no_scene_is_trivial_and_none_is_hopeless(name: str) -> None:
    scenario, seeds = SCENARIOS[name], range(1000, 1040)
    for same in ("cruise", "faster", "slower", "left", "right"):
        assert np.mean([r.success for r in drive(same, scenario, seeds)]) <= scenario.expect.constant_success_max, same
    lost = list(seeds)
    for driver in ("idm", "rule", "brake"):  # the next one where those before it have collided
        lost = [seed for seed, r in zip(lost, drive(driver, scenario, lost), strict=True) if r.collided] if lost else []
    assert 1.0 - len(lost) / len(seeds) >= scenario.expect.survivable


@pytest.mark.parametrize("name", SCENARIOS)
def test_even_random_actions_never_collide_behind_the_mask(name: str) -> None:
    assert not any(e.collided for e in drive("random-masked", SCENARIOS[name], range(1000, 1020)))


def test_idm_survives_where_cruising_does_not() -> None:
    assert not any(r.collided for r in drive("idm", SCENARIOS["highway"], range(1000, 1030)))


@pytest.mark.parametrize("algorithm", BASELINES)
def test_a_shipped_baseline_learnt_on_our_roads_with_the_papers_budget_and_never_collides_behind_our_mask(
    algorithm: str,
) -> None:
    ours = load_policy().sidecar
    theirs = [load_mlp(shipped(algorithm, variant)).sidecar for variant in VARIANTS]
    assert all(t["scenarios"] == ours["scenarios"] for t in theirs)
    assert all(int(str(t["steps"])) >= 100_000 for t in theirs)
    for name in ("highway", "merge", "two-way"):
        assert not any(r.collided for r in drive(f"{algorithm}-masked", SCENARIOS[name], range(1000, 1020)))


def test_a_bare_baseline_decides_as_often_as_the_others_and_nothing_overrides_it() -> None:
    world = Batched(SCENARIOS["highway"], 2, 0)
    left = ConstantPolicy(MetaAction.LEFT).logits
    step = by_the_tick(Driver(Fleet(world, task_of(SCENARIOS["highway"]), masked=False), left))
    for tick in range(31):
        settled = step(tick)
        assert settled is not None
        assert settled.decided.tolist() == [tick % DECISION_TICKS == 0] * 2
        assert not (settled.by_mask | settled.by_wish).any()


def test_the_same_seeds_give_the_same_table() -> None:
    first, second = (evaluate_all(["ours"], ["merge"], 5) for _ in range(2))
    assert first == second


def test_the_json_has_the_documented_rows_from_the_seed_it_was_asked_for() -> None:
    out = CliRunner().invoke(app, ["evaluate", "--scenario", "merge", "--episodes", "2", "--first-seed", "7", "--json"])
    printed = json.loads(out.stdout)
    assert printed["schema"] == SCHEMA
    assert printed["rows"][0].keys() >= {
        "agent",
        "scenario",
        "speed_set",
        "first_seed",
        "episodes",
        "success",
        "success_ci95",
        "ego_fault_collisions",
        "struck_collisions",
        "avg_speed",
        "max_speed",
        "min_speed",
        "accel_std",
        "accel_var",
        "min_ttc_mean",
        "min_ttc_median",
        "lane_compliance",
        "lane_feasible",
        "lane_compliance_feasible",
        "speed_compliance",
        "override_share",
        "ride_score",
        "ride_score_low",
        "ride_score_high",
        "lane_flips_per_min",
        "changes_given_up_per_min",
        "jerk_rms",
        "accel_sign_changes_per_min",
        "headway_under_1s_share",
        "min_ttc_capped_share",
        "never_complied_share",
        "decisions",
        "decisions_with_choice_share",
        "decisions_closed_by_mask_share",
        "decisions_closed_by_wish_share",
    }
    assert {f"{name}_of" for name in printed["rows"][0] if name.endswith(("_share", "_per_min"))} <= set(
        printed["rows"][0]
    )
    assert printed["rows"][0]["first_seed"] == 7


def test_a_road_may_be_denser_a_file_and_asked_for_something_later(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text('base = "highway"\nduration_s = 4.0\n', encoding="utf-8")
    told = ["--scenario", str(tmp_path / "short.toml"), "--density", "2", "--directive-at", "3", "--mask-preset", "sim"]
    out = CliRunner().invoke(app, ["evaluate", *told, "--episodes", "2", "--json"])
    (row,) = json.loads(out.stdout)["rows"]
    assert (row["scenario"], row["density"], row["directive_at_s"], row["mask_preset"]) == ("short", 2.0, 3.0, "sim")
    assert row["avg_speed_asked_of"] == 2 * 15


def test_without_words_the_ego_keeps_its_lane_and_the_speed_with_which_it_began() -> None:
    scenario = replace(SCENARIOS["highway"], flows=(), duration_s=6.0)
    silent, told = (drive("rule", scenario, [1000], directive_at_s=at)[0] for at in (6.0, 0.0))
    assert (silent.asked_ticks, told.asked_ticks) == (0, 90)
    assert silent.max_speed < 26.0 < told.max_speed
    assert silent.lane_flips == 0


def test_an_unknown_preset_is_refused_with_the_choice() -> None:
    with pytest.raises(ValueError, match="sim"):
        drive("ours", SCENARIOS["merge"], [1000], mask_preset="lunar")


def test_two_policies_alone_are_compared_by_seed_and_with_an_agent_beside_them_not() -> None:
    asked = ["evaluate", "--scenario", "merge", "--policy", "rule", "--policy", "constant:cruise", "--episodes", "2"]
    (row,) = json.loads(CliRunner().invoke(app, [*asked, "--json"]).stdout)["paired"]
    assert (row["first"], row["second"], row["ride_score"]["pairs"]) == ("rule", "constant:cruise", 2)
    assert "paired" not in json.loads(CliRunner().invoke(app, [*asked, "--agent", "idm", "--json"]).stdout)


def test_a_repeated_wish_gives_every_agent_one_row_each_that_names_it() -> None:
    asked = ["evaluate", "--scenario", "merge", "--agent", "rule", "--agent", "idm", "--wish", "10", "--wish", "15"]
    rows = json.loads(CliRunner().invoke(app, [*asked, "--episodes", "1", "--json"]).stdout)["rows"]
    assert [(r["agent"], r["wish_mps"]) for r in rows] == [("rule", 10), ("rule", 15), ("idm", 10), ("idm", 15)]


@pytest.mark.parametrize("wishes", [[], ["--wish", "15"], ["--wish", "15", "--wish", "15"]])
def test_a_picture_of_fewer_than_two_wishes_is_a_usage_error_that_names_the_fix(wishes: list[str]) -> None:
    result = CliRunner().invoke(app, ["evaluate", *wishes, "--plot", "never.png"])
    assert (result.exit_code, "--wish 20 --wish 25" in result.stderr) == (2, True)


def test_a_picture_without_matplotlib_is_refused_with_the_fix_before_any_driving(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(evaluate, "evaluate_all", None)  # it may not be asked for
    asked = ["evaluate", "--wish", "10", "--wish", "15", "--plot", str(tmp_path / "never.png")]
    result = CliRunner().invoke(app, asked)
    assert (result.exit_code, result.stderr) == (78, "fastslow: matplotlib is missing: pip install 'fastslow[view]'\n")


def test_speed_against_comfort_is_drawn(tmp_path: Path) -> None:
    rows = [
        {
            "agent": agent,
            "scenario": road,
            "wish_mps": wish,
            "avg_speed": wish - 1.0,
            "accel_var": 0.1,
            "min_ttc_mean": 9.0,
        }
        for agent in ("ours", "rule")
        for road in ("merge", "roadworks")
        for wish in (14, 15)
    ]
    report.plot(rows, tmp_path / "tradeoff.png")
    assert (tmp_path / "tradeoff.png").read_bytes().startswith(b"\x89PNG")


def copied(agent: Path, folder: Path, **sidecar: str) -> Path:
    """A checkpoint in a folder of its own, with these entries of its sidecar changed."""
    told = json.loads(agent.with_suffix(".json").read_text())
    (folder / "mine.json").write_text(json.dumps({**told, **sidecar}))
    (folder / "mine.safetensors").write_bytes(agent.read_bytes())
    return folder / "mine.safetensors"


def test_a_baselines_checkpoint_drives_as_that_baseline_and_takes_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = copied(shipped("ppo", "masked"), tmp_path)
    expected = evaluate_all(["ppo-masked"], ["merge"], 2)
    monkeypatch.setitem(AGENTS, "ppo-masked", replace(AGENTS["ppo-masked"], policy="nobody"))  # it may not be asked for
    assert evaluate_all(None, ["merge"], 2, checkpoint=mine) == expected


def test_a_checkpoint_that_no_agent_uses_or_nobody_knows_is_refused_with_the_fix(tmp_path: Path) -> None:
    mine = copied(shipped("ppo", "masked"), tmp_path)
    with pytest.raises(ConfigError, match="--agent ppo-masked"):
        evaluate_all(["ours"], ["merge"], 1, checkpoint=mine)
    with pytest.raises(ConfigError, match="train anew"):
        evaluate_all(None, ["merge"], 1, checkpoint=copied(shipped("ppo", "bare"), tmp_path, algorithm="sarsa"))


def test_a_checkpoint_of_a_learner_without_a_row_of_its_own_is_to_be_given_as_a_policy(tmp_path: Path) -> None:
    mine = copied(shipped("ppo", "masked"), tmp_path, algorithm="maskable-ppo")
    with pytest.raises(ConfigError, match=f"--policy {mine}"):
        evaluate_all(None, ["merge"], 1, checkpoint=mine)
    assert evaluate_all(None, ["merge"], 1, policies=[str(mine)])["rows"][0]["agent"] == str(mine)


def test_a_policy_is_not_taken_for_a_baseline_nor_a_baseline_for_a_policy() -> None:
    with pytest.raises(ConfigError, match="holds a baseline"):
        load_attention(shipped("ppo", "bare"))
    with pytest.raises(ConfigError, match="holds no baseline"):
        load_mlp(SHIPPED)


def test_any_policy_drives_behind_the_mask_and_is_a_row_beside_the_agents() -> None:
    rows = evaluate_all(["ours"], ["merge"], 2, policies=["fastslow", "constant:faster"])["rows"]
    assert [r["agent"] for r in rows] == ["ours", "fastslow", "constant:faster"]
    assert {**rows[0], "agent": "fastslow"} == rows[1]
    assert rows[2]["ego_fault_collisions"] == 0 < rows[2]["override_share"]


def test_a_policy_that_cannot_be_used_is_one_line_and_exit_code_78(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["evaluate", "--policy", "no_such_module:load", "--scenario", "merge"])
    assert (result.exit_code, "no_such_module" in result.stderr, "Traceback" in result.output) == (78, True, False)


def test_an_unknown_agent_scenario_or_directive_is_refused_with_the_choice() -> None:
    with pytest.raises(ValueError, match="ours"):
        evaluate_all(["nobody"], ["merge"], 1)
    with pytest.raises(ValueError, match="highway"):
        evaluate_all(["ours"], ["moon"], 1)
    with pytest.raises(ValueError, match="hurry"):
        evaluate_all(["ours"], ["merge"], 1, directive="sing")  # type: ignore[arg-type]


def test_the_wilson_interval_is_the_textbooks() -> None:
    assert wilson95(90, 100) == pytest.approx([0.8256, 0.9448], abs=1e-4)


def record(
    *ticks: list[list[float]], accel: tuple[float, ...] = (), crashed: bool = False, way_open: bool = False
) -> Recorder:
    recorder, one = Recorder(SCENARIOS["two-way"], 1), np.ones(1, np.int64)
    for k, rows in enumerate(ticks):
        recorder.tick(
            np.array([rows], np.float32),
            np.array([accel[k] if accel else 0.0]),
            one,
            -one,
            np.array([crashed and k == len(ticks) - 1]),
            np.ones(1, np.bool_),
            one,
            np.array([6.0]),
            way_open=np.array([way_open]),
        )
    return recorder


def test_time_to_collision_is_the_bumper_gap_over_the_closing_speed() -> None:
    ego = car(0, 400, 1, 6)
    assert record([ego, car(1, 425, 1, 4)]).results()[0].min_ttc_s == pytest.approx(10.0)  # 20 m at 2 m/s
    assert record([ego, car(1, 425, 0, -4)]).results()[0].min_ttc_s == 100.0  # in the other lane
    assert record([ego, car(1, 425, 1, 5.95)]).results()[0].min_ttc_s == 100.0  # closing below 0.1 m/s


def test_a_collision_makes_the_time_to_collision_zero_and_the_episode_no_success() -> None:
    result = record([car(0, 400, 1, 6), car(1, 404, 1, 4)], crashed=True).results()[0]
    assert (result.min_ttc_s, result.success, result.struck) == (0.0, False, False)


def test_being_run_into_from_behind_is_not_the_egos_fault() -> None:
    assert record([car(0, 400, 1, 5), car(2, 395.5, 1, 8)], crashed=True).results()[0].struck


@pytest.mark.parametrize(
    ("ours_mps", "theirs_mps", "struck"),
    [(0.0, -1.0, True), (1.0, 0.0, False), (1.0, -1.0, False), (-1.0, -1.0, False)],
)
def test_sideways_only_who_moves_towards_a_car_that_keeps_its_place_strikes_it(
    ours_mps: float, theirs_mps: float, struck: bool
) -> None:
    ego, other = car(0, 400, 0, 6), car(1, 401, 1, 6)
    other[Y] = ego[Y] + 1.9
    ego[VY], other[VY] = ours_mps, theirs_mps
    assert record([ego, other], crashed=True).results()[0].struck == struck


def test_acceleration_jerk_and_headway_are_the_hand_computed_ones() -> None:
    ticks = [[car(0, 400, 1, 5), car(1, 415, 1, 5)]] * 3
    result = record(*ticks, accel=(0.0, 1.0, 1.0)).results()[0]
    assert (result.accel_sum, result.accel_square_sum) == (2.0, 2.0)
    assert result.jerk_rms == pytest.approx(15.0 / np.sqrt(3.0))  # one step of 15 m/s3 in three ticks
    assert result.headway_s == pytest.approx(2.0)  # 10 m at 5 m/s


def test_speeds_of_several_episodes_are_weighted_by_their_ticks() -> None:
    short = record([car(0, 400, 1, 8)]).results()
    long = record(*[[car(0, 400, 1, 4)]] * 3).results()
    assert summarise(short + long)["avg_speed"] == pytest.approx(5.0)


def test_lane_compliance_is_reaching_the_wished_lane() -> None:
    result = record([car(0, 400, 0, 6)], [car(0, 400, 1, 6)], [car(0, 400, 1, 6)]).results()[0]
    assert (result.in_lane, result.time_to_comply_s) == (pytest.approx(2 / 3), pytest.approx(2 / 15))
    assert summarise([result])["lane_compliance"] == 1.0


def test_a_wished_lane_was_feasible_once_reached_or_open_for_a_second_in_all() -> None:
    outside = [[car(0, 400, 0, 6)]]
    reached, shut = record([car(0, 400, 1, 6)]).results(), record(*outside * 20).results()
    missed, brief = (record(*outside * n, way_open=True).results() for n in (15, 14))
    assert [r[0].lane_feasible for r in (reached, missed, brief, shut)] == [True, True, False, False]


def test_lane_compliance_is_of_all_episodes_and_again_of_those_in_which_it_was_feasible() -> None:
    outside = [[car(0, 400, 0, 6)]]
    reached, shut = record([car(0, 400, 1, 6)]).results(), record(*outside * 20).results()
    missed = record(*outside * 15, way_open=True).results()
    summary = summarise([*reached, *missed, *shut, *shut])
    assert (summary["lane_compliance"], summary["lane_feasible"], summary["lane_compliance_feasible"]) == (
        0.25,
        0.5,
        0.5,
    )


def test_the_way_is_open_where_the_mask_leaves_the_next_change_towards_the_wish() -> None:
    fleet = Fleet(Batched(SCENARIOS["highway"], 4, 0), task_of(SCENARIOS["highway"]))
    lane, fleet.wish[:] = np.full(4, 1), [3, 3, 1, ANY_LANE]
    fleet.rule[:] = OPEN
    fleet.rule[1, MetaAction.RIGHT] = REAR_GAP
    assert way_is_open(fleet, lane).tolist() == [True, False, False, False]


def test_speed_compliance_counts_the_ticks_in_which_the_wish_was_feasible() -> None:
    settling, free = [[car(0, 400, 1, 5.0)]] * 75, [[car(0, 400, 1, 5.6)], [car(0, 400, 1, 5.4)]]
    blocked = [[car(0, 400, 1, 4.0), car(1, 415, 1, 4.0)]] * 3
    result = record(*settling, *free, *blocked).results()[0]
    assert (result.speed_ticks, result.speed_complied) == (2, 1)
