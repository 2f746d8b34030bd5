"""The study: baselines on our scenes, resuming, and the table's arithmetic."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from deploy.cli.app import app
from deploy.lab.farm import Farm
from deploy.lab.files import write_table
from deploy.lab.statistics import t_interval, wilson95
from deploy.lab.study import cells, matrix
from deploy.lab.study.cells import Cell, cells_of, finished, run_cell
from deploy.lab.study.matrix import run_cells
from deploy.lab.study.report import search_rows, search_table, summary_of, table
from deploy.lab.training import mixed_scenes, train_policy
from fast_node.mask import NOT_WISHED, OPEN
from fast_node.policies.mlp import WISH, load_mlp
from fast_node.training.train import saved_state
from schemas.driving.features import FEATURES, LAYOUT_HASH, N_ROWS
from schemas.driving.intent import ANY_LANE
from schemas.runtime.process import ConfigError
from schemas.wire.messages import MetaAction
from sim_node.scenarios import SCENARIOS

TOY = Cell("ours", "masked", "two-way", 0, 256, 2)


def baseline(algorithm: str, variant: str, out: Path, steps: int = 64) -> None:
    """Train a toy in four scenes; the export checks itself against torch."""
    pytest.importorskip("stable_baselines3")
    from fast_node.training.baselines import learn

    scenes = mixed_scenes(["two-way"], 0, scenes=4, hurried=variant == "bare", masked=variant != "bare")
    learn(algorithm, scenes, out, variant=variant, steps=steps, seed=0)


def vec_scenes(variant: str) -> Any:
    pytest.importorskip("stable_baselines3")
    from fast_node.training.baselines import VecScenes

    return VecScenes(mixed_scenes(["two-way"], 0, scenes=8, hurried=True, masked=variant != "bare"), variant)


def drive_until_done(env: Any, action: MetaAction) -> list[tuple[np.ndarray, dict[str, Any]]]:
    """(what is seen next, info) of every scene whose first episode has ended, at the step where one did."""
    env.reset()
    for _ in range(300):
        seen, _, done, infos = env.step(np.full(env.num_envs, int(action)))
        if done.any():
            return [(seen[s], infos[s]) for s in np.flatnonzero(done)]
    raise AssertionError("no episode ended")


def test_a_crash_is_no_truncation_and_the_next_episode_follows_at_once() -> None:
    for seen, info in drive_until_done(vec_scenes("bare"), MetaAction.SPEED_UP):
        assert info["TimeLimit.truncated"] is False
        assert not np.array_equal(info["terminal_observation"], seen)


def test_an_episode_that_runs_out_of_time_is_marked_for_bootstrapping_with_its_last_observation() -> None:
    for seen, info in drive_until_done(vec_scenes("masked"), MetaAction.CRUISE):
        assert info["TimeLimit.truncated"] is True
        assert not np.array_equal(info["terminal_observation"], seen)


def test_a_bare_baseline_is_not_shown_the_wish() -> None:
    env = vec_scenes("bare")
    assert not env.reset().reshape(-1, N_ROWS, len(FEATURES))[:, 0, WISH].any()
    assert vec_scenes("masked").reset().reshape(-1, N_ROWS, len(FEATURES))[:, 0, WISH].any()


@pytest.mark.parametrize("algorithm", ["ppo", "a2c", "dqn"])
def test_an_exported_baseline_answers_as_torch_does_and_a_bare_one_whatever_is_wished(
    algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("stable_baselines3")
    from fast_node.training import baselines

    monkeypatch.setitem(baselines.CONFIG, "ppo", {"n_steps": 16, "batch_size": 64})
    out = tmp_path / "b.safetensors"
    baseline(algorithm, "bare", out)  # raises when they differ
    x = np.random.default_rng(0).normal(size=(2, N_ROWS, len(FEATURES))).astype(np.float32)
    wished = x.copy()
    wished[:, 0, WISH] += 1.0
    policy = load_mlp(out)
    assert np.array_equal(policy.logits(x), policy.logits(wished))
    assert policy.sidecar["algorithm"] == algorithm


def test_a_baseline_for_other_features_is_refused_with_the_fix(tmp_path: Path) -> None:
    out = tmp_path / "b.safetensors"
    baseline("a2c", "masked", out)
    sidecar = json.loads(out.with_suffix(".json").read_text())
    assert sidecar["layout_hash"] == LAYOUT_HASH
    out.with_suffix(".json").write_text(json.dumps({**sidecar, "layout_hash": "other"}))
    with pytest.raises(ConfigError, match="train it anew"):
        load_mlp(out)


@pytest.mark.parametrize("variant", ["mask-only", "wish-only"])
def test_half_a_baseline_is_learnt_measured_and_read_back(variant: str, tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    run_cell(Cell("a2c", variant, "two-way", 0, 256, 2), tmp_path)
    sidecar = load_mlp(tmp_path / f"two-way-a2c-{variant}-0.safetensors").sidecar
    assert (sidecar["variant"], sidecar["mask"] is None) == (variant, variant == "wish-only")


def test_behind_the_mask_alone_a_wish_closes_nothing() -> None:
    closed = {
        obeyed: mixed_scenes(["highway"], 0, scenes=32, hurried=True, obeyed=obeyed).parts[0].rule
        for obeyed in (True, False)
    }
    assert (closed[True] == NOT_WISHED).any()
    assert np.array_equal(np.where(closed[True] == NOT_WISHED, OPEN, closed[True]), closed[False])


def test_hurried_scenes_never_ask_for_anything_else() -> None:
    scenes = mixed_scenes(["highway"], 0, scenes=4, hurried=True).parts[0]
    for _ in range(20):
        scenes.decide(np.full(4, int(MetaAction.CRUISE)))
    assert set(scenes.told_lane) == {ANY_LANE}
    assert set(scenes.v_des) == {SCENARIOS["highway"].ego.speed_ceiling_mps}


CLEANRL = {f"charts/{name}" for name in ("episodic_return", "episodic_length", "learning_rate", "SPS")} | {
    f"losses/{name}" for name in ("policy_loss", "value_loss", "entropy", "approx_kl", "clipfrac", "explained_variance")
}


def progress_of(out: Path) -> list[dict[str, str]]:
    with out.with_suffix(".progress.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training of a moment."""
    folder = tmp_path_factory.mktemp("trained")
    train_policy(folder / "p.safetensors", ["two-way"], 1024, 0)
    return folder


@pytest.fixture
def trained(once: Path, tmp_path: Path) -> Path:
    """Its policy, with all that lies beside it, for one test to change."""
    shutil.copytree(once, tmp_path, dirs_exist_ok=True)
    return tmp_path / "p.safetensors"


def test_a_resumed_training_goes_on_where_it_was_saved_and_says_so(trained: Path) -> None:
    train_policy(trained, ["two-way"], 2048, 0, resume=True)
    sidecar = json.loads(trained.with_suffix(".json").read_text())
    assert (sidecar["steps"], sidecar["resumed_at"]) == (2048, [1024])
    assert [row["global_step"] for row in progress_of(trained)] == ["1024", "2048"]


def test_a_training_that_starts_from_another_begins_with_its_network_and_says_so(trained: Path) -> None:
    then = trained.with_name("then.safetensors")
    train_policy(then, ["merge"], 1024, 7, lr=1e-30, start=trained)  # too little to change a weight
    assert then.read_bytes() == trained.read_bytes()
    start = json.loads(then.with_suffix(".json").read_text())["start"]
    assert (start["steps"], start["seed"], start["scenarios"]) == (1024, 0, ["two-way"])


def test_a_started_training_can_be_resumed(trained: Path) -> None:
    then = trained.with_name("then.safetensors")
    train_policy(then, ["merge"], 1024, 0, start=trained)
    train_policy(then, ["merge"], 2048, 0, resume=True)
    assert json.loads(then.with_suffix(".json").read_text())["start"]["scenarios"] == ["two-way"]


def test_a_training_does_not_start_from_a_policy_without_its_state_or_of_another_mask(trained: Path) -> None:
    import torch

    none, then = trained.with_name("none.safetensors"), trained.with_name("then.safetensors")
    with pytest.raises(ConfigError, match=r"no none\.train\.pt.*--start"):
        train_policy(then, ["merge"], 1024, 0, start=none)
    state = saved_state(trained)
    state["run"]["mask"] = "mask/0"
    torch.save(state, trained.with_suffix(".train.pt"))
    with pytest.raises(ConfigError, match=r"mask/0.*train it anew"):
        train_policy(then, ["merge"], 1024, 0, start=trained)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (["--resume", "--start", "p.safetensors"], "--start"),
        (["--algorithm", "ppo", "--resume"], "--resume"),
        (["--algorithm", "a2c", "--learning-rate", "0"], "--learning-rate"),
        (["--bare"], "--bare"),
    ],
)
def test_options_of_a_training_that_exclude_each_other_are_a_usage_error(given: list[str], named: str) -> None:
    result = CliRunner().invoke(app, ["train", *given, "--steps", "1024"])
    assert (result.exit_code, f"'{named}'" in result.stderr) == (2, True)


def test_every_update_is_logged_under_cleanrls_names(trained: Path) -> None:
    rows = progress_of(trained)
    assert rows[0].keys() >= CLEANRL | {"global_step"}
    events = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    board = events.EventAccumulator(str(trained.with_suffix(".tensorboard"))).Reload()
    assert set(board.Tags()["scalars"]) >= CLEANRL


def test_a_sidecar_tells_all_that_its_training_depended_on(trained: Path) -> None:
    sidecar = json.loads(trained.with_suffix(".json").read_text())
    assert sidecar.keys() == {
        "algorithm",
        "features",
        "heads",
        "layers",
        "layout_hash",
        "learner",
        "lr_schedule",
        "mask",
        "mask_preset",
        "metrics",
        "resumed_at",
        "revision",
        "reward",
        "rollout",
        "scenarios",
        "scenes",
        "seed",
        "sha256",
        "steps",
        "width",
    }
    assert (sidecar["rollout"], sidecar["scenes"], sidecar["reward"]["crash"]) == (16, [64], -10.0)


def test_a_state_from_before_masks_and_features_were_noted_is_refused_with_the_fix(trained: Path) -> None:
    import torch

    state = saved_state(trained)
    del state["run"]["layout_hash"], state["run"]["mask"]
    torch.save(state, trained.with_suffix(".train.pt"))
    with pytest.raises(ConfigError, match=r"mask None.*layout_hash None.*train anew"):
        train_policy(trained, ["two-way"], 2048, 0, resume=True)


def test_a_training_is_not_resumed_from_nothing_nor_as_another(trained: Path) -> None:
    with pytest.raises(ConfigError, match="without --resume"):
        train_policy(trained.with_name("none.safetensors"), ["two-way"], 1024, 0, resume=True)
    with pytest.raises(ConfigError, match="train anew"):
        train_policy(trained, ["two-way"], 2048, 1, resume=True)
    with pytest.raises(ConfigError, match="--steps"):
        train_policy(trained, ["two-way"], 1024, 0, resume=True)


def test_the_study_skips_finished_cells_and_not_those_of_other_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run_cell(TOY, tmp_path)
    monkeypatch.setattr(matrix, "run_away", None)  # none may be run
    assert run_cells([TOY], tmp_path, Farm()) == [json.loads(json.dumps(result))]
    assert [step for step, _ in result["curve"]] == [0, 1024]
    assert finished(Cell("ours", "masked", "two-way", 0, 512, 2), tmp_path) is None


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the cells of a baseline in both variants have been run."""
    pytest.importorskip("stable_baselines3")
    folder = tmp_path_factory.mktemp("cells")
    for cell in BASELINE.values():
        run_cell(cell, folder)
    return folder


BASELINE = {variant: Cell("a2c", variant, "two-way", 0, 256, 2) for variant in ("bare", "masked")}


def test_a_cell_that_was_run_with_other_settings_of_the_baseline_is_run_again(
    done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fast_node.training import baselines

    assert finished(BASELINE["masked"], done)
    monkeypatch.setitem(baselines.CHOSEN, "a2c", "gae")
    assert finished(BASELINE["masked"], done) is None


@pytest.mark.parametrize("variant", BASELINE)
def test_a_cell_of_another_version_of_the_mask_is_run_again_for_the_reward_depends_on_it_too(
    done: Path, monkeypatch: pytest.MonkeyPatch, variant: str
) -> None:
    assert finished(BASELINE[variant], done)
    monkeypatch.setattr(cells, "MASK_VERSION", "mask/0")
    assert finished(BASELINE[variant], done) is None


def test_the_search_tells_trials_apart_and_puts_the_one_that_earns_most_first() -> None:
    found = [
        {**result("a2c", earned, variant=variant), "trial": trial}
        for trial, variant, earned in (
            ("start", "bare", 1.0),
            ("start", "masked", 2.0),
            ("gae", "bare", 4.0),
            ("gae", "masked", 1.0),
        )
    ]
    rows = search_rows(found)
    assert [(r["trial"], r["runs"], r["return"]) for r in rows] == [("gae", 2, 2.5), ("start", 2, 1.5)]
    assert rows[0]["returns"] == {"merge bare": 4.0, "merge masked": 1.0}
    assert "| a2c | **start** | 2 | 1.00 | 2.00 | 1.500 |" in search_table(rows, {"a2c": "start"})


def test_the_matrix_has_ours_once_and_every_baseline_in_both_variants() -> None:
    assert len(cells_of(cells.ALGORITHMS, cells.ROADS, cells.SEEDS, 100_000)) == 8 * 3 * 5
    with pytest.raises(ValueError, match="a2c"):
        cells_of(["sarsa"], ["merge"], [0], 100)


def result(algorithm: str, final: float, seed: int = 0, variant: str = "masked", early: float = 0.0) -> dict[str, Any]:
    return {
        "algorithm": algorithm,
        "variant": variant,
        "scenario": "merge",
        "seed": seed,
        "episodes": 100,
        "curve": [[0, -1.0], [30_000, early], [100_352, final]],
        **dict.fromkeys(cells.FIGURES, 0.5),
    }


def test_the_interval_over_seeds_is_students() -> None:
    assert t_interval([1.0, 2.0, 3.0]) == pytest.approx((2.0, 4.303 / 3**0.5))
    assert t_interval([1.0]) == (1.0, None)


def test_the_summary_is_the_hand_computed_one() -> None:
    rows = summary_of(
        [result("ours", 2.0, 0, early=1.0), result("ours", 3.0, 1, early=2.0), result("a2c", -1.0, 0, "bare")]
    )
    ours = rows[0]
    assert (ours["seeds"], ours["return"], ours["return_early"], ours["episodes"]) == (2, 2.5, 1.5, 200)
    assert ours["success_ci95"] == pytest.approx(wilson95(100, 200))


def test_ours_is_above_or_below_another_only_where_the_intervals_are_apart() -> None:
    some = [result("ours", 2.0 + 0.01 * k, k) for k in range(3)]
    some += [result("ppo", 1.0 + 0.01 * k, k) for k in range(3)] + [result("dqn", 3.0 + 0.01 * k, k) for k in range(3)]
    some += [result("a2c", 1.0 + k, k) for k in range(3)]
    rows = summary_of(some)
    assert {r["algorithm"]: r["ours"] for r in rows} == {"ours": "", "ppo": "above", "dqn": "below", "a2c": ""}
    assert "| merge | ppo masked | 1.01 ± 0.02 | above | 0.00 | 50.0 (44-56) |" in table(rows)


def test_a_study_leaves_a_table_with_the_ends_of_its_intervals(tmp_path: Path) -> None:
    write_table(summary_of([result("ours", 2.0, 0), result("ours", 3.0, 1)]), tmp_path / "study.csv")
    with (tmp_path / "study.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["algorithm"], row["seeds"], row["return"], row["success_low"]) == ("ours", "2", "2.5", "0.4314")


@pytest.mark.parametrize(("final", "code"), [(matrix.QUICK_RETURN + 0.1, 0), (matrix.QUICK_RETURN - 0.1, 1)])
def test_the_quick_study_fails_below_its_return(
    final: float, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matrix, "run_cells", lambda *_: [result("ours", final, seed) for seed in range(3)])
    assert matrix.run_study(tmp_path, quick=True) == code
    assert json.loads((tmp_path / "quick" / "study.json").read_text())["schema"] == matrix.SCHEMA
    assert (tmp_path / "quick" / "study.png").exists()


def test_the_quick_study_finds_no_cell_to_resume_and_leaves_a_full_study_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, full = tmp_path / "quick" / "cells" / "two-way-ours-masked-0.result.json", tmp_path / "study.json"
    for file in (old, full):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("{}")
    found: list[Path] = []

    def run(todo: Any, folder: Path, farm: Farm) -> list[dict[str, Any]]:
        found.extend(folder.parent.rglob("*"))
        return [result("ours", 9.0, seed) for seed in range(3)]

    monkeypatch.setattr(matrix, "run_cells", run)
    matrix.run_study(tmp_path, quick=True)
    assert (found, full.read_text()) == ([], "{}")
