"""`fastslow train --config FILE --set NAME=VALUE --track`: what reaches the learner, and what is refused by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from deploy.cli.app import app
from fast_node.training.learner import LearnerConfig

pytest.importorskip("stable_baselines3")


def trained(folder: Path, *given: str, config: str = "") -> tuple[int, str, dict[str, Any]]:
    """Exit code, what is printed, and the sidecar of a moment of training on two-way."""
    out, words = folder / "p.safetensors", ["--out", str(folder / "p.safetensors"), *given]
    if config:
        (folder / "c.toml").write_text(config)
        words += ["--config", str(folder / "c.toml")]
    result = CliRunner().invoke(
        app, ["train", "--scenario", "two-way", "--steps", "1024", *words], env={"COLUMNS": "500"}
    )
    sidecar = out.with_suffix(".json")
    return result.exit_code, result.output, json.loads(sidecar.read_text()) if sidecar.exists() else {}


def test_a_file_sets_hyper_parameters_and_options_and_the_command_line_wins(tmp_path: Path) -> None:
    config = "seed = 7\nmask-preset = 'cautious'\n[learner]\ngamma = 0.9\nscenes = 8\nentropy = 0.5"
    code, _, sidecar = trained(tmp_path, "--set", "entropy=0.02", config=config)
    assert code == 0
    assert (sidecar["seed"], sidecar["scenes"], sidecar["mask_preset"]) == (7, [8], "cautious")
    assert sidecar["learner"] == {**vars(LearnerConfig(gamma=0.9, entropy=0.02))}


def test_a_baseline_takes_the_settings_of_stable_baselines3_by_their_names(tmp_path: Path) -> None:
    given = ("--algorithm", "maskable-ppo", "--set", "n_steps=16", "--set", "scenes=8", "--set", "target_kl=none")
    code, _, sidecar = trained(tmp_path, *given)
    assert code == 0
    assert (sidecar["learner"]["n_steps"], sidecar["learner"]["target_kl"], sidecar["scenes"]) == (16, None, [8])


@pytest.mark.parametrize(
    ("given", "config", "said"),
    [
        (("--set", "gama=0.9"), "", "ours has no setting 'gama': choose from scenes, gamma"),
        (("--set", "gamma=2"), "", "gamma 2.0 is not within 0..1"),
        (("--set", "gamma=fast"), "", "Expected `float`, got `str`"),
        (("--learning-rate", "0"), "", "lr 0.0 is not a positive number"),
        (("--set", "lr=-1"), "", "lr -1.0 is not a positive number"),
        (("--set", "epochs=0"), "", "epochs 0 is not a positive number"),
        (("--set", "max_grad_norm=0"), "", "max_grad_norm 0.0 is not a positive number"),
        (("--algorithm", "dqn", "--set", "buffer_size=0"), "", "buffer_size 0 is not a whole number above 0"),
        (("--algorithm", "dqn", "--set", "batch_size=0"), "", "batch_size 0 is not a whole number above 0"),
        (("--algorithm", "dqn", "--set", "train_freq=0"), "", "train_freq 0 is not a whole number above 0"),
        (("--algorithm", "dqn", "--set", "gradient_steps=0"), "", "gradient_steps 0 is not a whole number above 0"),
        (("--algorithm", "dqn", "--set", "learning_starts=1024"), "", "learning_starts 1024 is not within 0..1023"),
        (("--algorithm", "dqn", "--set", "gamma=nan"), "", "gamma nan is not within 0..1"),
        (("--algorithm", "dqn", "--set", "tau=-1"), "", "tau -1 is not within 0..1"),
        (("--algorithm", "dqn", "--set", "buffer_size=1000000000000"), "", "dqn does not take {'buffer_size': 1000"),
        (("--algorithm", "ppo", "--set", "n_epochs=0"), "", "n_epochs 0 is not a whole number above 0"),
        (("--algorithm", "ppo", "--set", "clip_range=-1"), "", "clip_range -1 is not a positive number"),
        (("--algorithm", "ppo", "--set", "ent_coef=nan"), "", "ent_coef nan is not a finite number"),
        (("--algorithm", "a2c", "--set", "n_steps=2.5"), "", "n_steps 2.5 is not a whole number above 0"),
        (("--algorithm", "a2c", "--set", "learning_rate=0"), "", "learning_rate 0 is not a positive number"),
        (("--set", "scenes=0"), "", "scenes 0 is not a whole number within 1..4096"),
        (("--set", "gamma"), "", "'gamma' is not NAME=VALUE"),
        (("--learning-rate", "1e-3", "--set", "lr=1e-3"), "", "give it once"),
        (("--algorithm", "dqn", "--set", "n_epochs=4"), "", "dqn has no setting 'n_epochs': choose from scenes, "),
        (("--algorithm", "ppo", "--set", "n_steps=four"), "", "ppo does not take {'n_steps': 'four'}"),
        (("--algorithm", "maskable-ppo", "--bare"), "", "learns by what the mask closes"),
        (("--algorithm", "taught", "--set", "gamma=1"), "", "for learners by reward alone"),
        ((), "sede = 7", "has 'sede': choose from algorithm, bare"),
        ((), "[learner]\ngama = 1", "ours has no setting 'gama'"),
        ((), "learner = 1", "learner is to be a table"),
        ((), "seed = ", "c.toml: Invalid value"),
        ((), "seed = 'x'", "Input should be a valid integer"),
        (("--config", "none.toml"), "", "there is no file none.toml: check the path"),
        (("--config", "/dev/zero"), "", "/dev/zero is no plain file: give a file"),
        pytest.param((), "#" * 50_001, "c.toml is larger than 50,000 bytes", id="a huge file"),
    ],
)
def test_what_is_no_setting_is_refused_by_name(tmp_path: Path, given: tuple[str, ...], config: str, said: str) -> None:
    code, output, sidecar = trained(tmp_path, *given, config=config)
    assert (code, sidecar) == (2, {})
    assert not list(tmp_path.glob("p.*"))  # of an earlier run, it would be lost
    assert said in " ".join(output.split())


@pytest.mark.parametrize("algorithm", ["ours", "ppo"])
def test_a_tracked_run_is_kept_offline_beside_the_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, algorithm: str
) -> None:
    pytest.importorskip("wandb")
    for name in ("WANDB_MODE", "WANDB_ERROR_REPORTING"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    code, _, _ = trained(tmp_path, "--track", "--algorithm", algorithm, "--set", "scenes=64")
    assert code == 0
    assert len(list((tmp_path / "wandb").glob("offline-run-*/run-*.wandb"))) == 1


def test_a_baseline_leaves_its_figures_too(tmp_path: Path) -> None:
    trained(tmp_path, "--algorithm", "ppo", "--steps", "3072", "--set", "scenes=8")
    rows = (tmp_path / "p.progress.csv").read_text().splitlines()
    assert rows[0] == "global_step,charts/episodic_return,charts/crash_rate,charts/SPS"
    assert len(rows) > 1
    assert list((tmp_path / "p.tensorboard").iterdir())
