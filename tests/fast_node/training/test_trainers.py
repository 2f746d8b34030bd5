"""Every trainer of the fast node: a few steps on tiny worlds, from the first weights to a policy that drives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.lab import teaching
from deploy.lab.training import mixed_scenes, train_policy
from fast_node.policies.attention import load_attention
from fast_node.policies.mlp import load_mlp
from fast_node.training import foresight
from fast_node.training.train import random_inputs, train
from schemas.driving.features import Array
from schemas.runtime.process import ConfigError

TRAINERS = ("ours", "ppo", "dqn", "a2c", "maskable-ppo")
DECISIONS = 256
SEEN = random_inputs(3)


def trained(algorithm: str, out: Path, seed: int = 0) -> Array:
    """Train for a moment and export to `out`; what the first, random weights made of SEEN."""
    scenes = mixed_scenes(["two-way"], seed, scenes=8)
    first: list[Array] = []

    def watch(done: int, logits: Any) -> None:
        if done == 0:
            first.append(np.array(logits(SEEN)))

    if algorithm == "ours":
        train(scenes, out, steps=DECISIONS, seed=seed, progress=lambda *_: None, watch=watch)
    else:
        baselines = pytest.importorskip("fast_node.training.baselines", exc_type=ImportError)
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(baselines.CONFIG["dqn"], "learning_starts", 64)  # else it would not have begun by then
            baselines.learn(algorithm, scenes, out, variant="masked", steps=DECISIONS, seed=seed, watch=watch)
    return first[0]


@pytest.mark.parametrize("algorithm", TRAINERS)
def test_a_moment_of_training_changes_what_the_exported_policy_answers(algorithm: str, tmp_path: Path) -> None:
    before = trained(algorithm, tmp_path / "p.safetensors")
    policy = (load_attention if algorithm == "ours" else load_mlp)(tmp_path / "p.safetensors")
    after = np.array([policy.logits(x) for x in SEEN])
    assert after.shape == before.shape == (3, 5)
    assert np.isfinite(after).all()
    assert not np.allclose(after, before, atol=1e-4)


@pytest.mark.parametrize("algorithm", TRAINERS)
def test_the_same_seed_gives_the_same_weights_to_the_bit_and_another_seed_others(
    algorithm: str, tmp_path: Path
) -> None:
    one, same, other = (tmp_path / f"{name}.safetensors" for name in ("one", "same", "other"))
    for out, seed in ((one, 0), (same, 0), (other, 1)):
        trained(algorithm, out, seed)
    assert one.read_bytes() == same.read_bytes() != other.read_bytes()


def test_a_moment_of_teaching_gives_a_policy_that_drives_and_that_learning_starts_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, name, value in ((teaching, "SCENES", 4), (teaching, "ROUNDS", 1), (foresight, "AHEAD", 2)):
        monkeypatch.setattr(module, name, value)
    taught, further = tmp_path / "taught.safetensors", tmp_path / "further.safetensors"
    teaching.teach_policy(taught, ["two-way"], steps=8, seed=0, jobs=1)
    assert np.isfinite(load_attention(taught).logits(SEEN)).all()
    with pytest.raises(ConfigError, match=r"no run to resume.*--start"):
        train_policy(taught, ["two-way"], DECISIONS, 0, resume=True)
    train_policy(further, ["two-way"], DECISIONS, 0, start=taught)
    assert further.read_bytes() != taught.read_bytes()
