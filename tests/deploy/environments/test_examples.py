"""The scripts and the notebook in docs/examples work, with tiny budgets."""

from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"


def example(name: str) -> ModuleType:
    """A script as a module; skipped where a package of extra `train` is missing."""
    for package in ("stable_baselines3", "sb3_contrib", "pettingzoo"):
        pytest.importorskip(package)
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("masked", [[], ["--masked"]])
def test_stable_baselines3_learns_and_its_policy_drives_the_live_car(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, masked: list[str]
) -> None:
    script: Any = example("sb3_ppo")
    saved = tmp_path / "model.zip"
    monkeypatch.setattr(script, "SAVED", saved)
    few = ["--steps", "512", "--envs", "8", "--episodes", "1", "--scenario", "two-way", "--out", str(saved)]
    earned, crashed = script.main([*few, *masked])
    assert math.isfinite(earned)
    assert crashed == 0.0  # behind the mask
    logits = script.load().logits(np.zeros((3, 15, 26), np.float32))
    assert logits.shape == (3, 5)
    assert np.isfinite(logits).all()


def test_cleanrls_ppo_in_one_file_learns_and_leaves_its_curves(tmp_path: Path) -> None:
    script: Any = example("cleanrl_ppo")
    few = ["--env-id", "fastslow/TwoWay-v0", "--total-timesteps", "2048", "--num-envs", "8", "--num-steps", "128"]
    assert math.isfinite(script.main([*few, "--runs", str(tmp_path)]))
    (run,) = tmp_path.iterdir()
    assert run.name.startswith("fastslow-TwoWay-v0__cleanrl_ppo__1__")
    assert {path.name.split(".")[0] for path in run.iterdir()} == {"events", "agent"}


def test_several_cars_drive_with_a_directive_each() -> None:
    script: Any = example("several_cars")
    assert set(script.main(["--cars", "2", "--seconds", "2"])) == {"car_0", "car_1"}


def test_every_cell_of_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    example("several_cars")
    monkeypatch.chdir(tmp_path)
    cells = json.loads((EXAMPLES / "train_tonight.ipynb").read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]).replace("STEPS = 100_000", "STEPS = 512"), names)
    assert names["picture"].shape == (360, 960, 3)
    assert names["returns"]
