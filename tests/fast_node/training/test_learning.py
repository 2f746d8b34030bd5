"""The learning code against numbers worked out by hand, and the export against torch."""

from __future__ import annotations

import json
import math
from typing import Any, cast

import numpy as np
import pytest
import torch

from deploy.lab.training import mixed_scenes
from fast_node.policies.attention import load_attention
from fast_node.training import train as training
from fast_node.training.learner import (
    LearnerConfig,
    advantages,
    explained_variance,
    following_values,
    masked_distribution,
    update,
)
from fast_node.training.mixed import Mixed
from fast_node.training.network import ActorCritic
from fast_node.training.train import export, train
from schemas.driving.features import FEATURES, N_ROWS, features
from schemas.driving.road import DECISION_TICKS, HZ
from schemas.runtime.process import ConfigError
from schemas.wire.messages import MetaAction


def column(*values: float) -> np.ndarray:
    return np.array(values, np.float32)[:, None]


def test_advantages_follow_the_hand_computed_sum():
    # delta_1 = 2 + 0.5*0 - 1 = 1; delta_0 = 1 + 0.5*1 - 0.5 = 1; A_0 = 1 + 0.5*0.5*1 = 1.25
    a = advantages(
        column(1, 2),
        column(0.5, 1),
        column(1, 0),
        column(0, 1).astype(bool),
        column(0, 1).astype(bool),
        gamma=0.5,
        lam=0.5,
    )
    assert a[:, 0].tolist() == [1.25, 1.0]


def test_a_truncated_episode_is_bootstrapped_and_a_terminated_one_is_not():
    ended, no = column(1).astype(bool), column(0).astype(bool)
    assert advantages(column(1), column(0), column(4), no, ended, 0.5, 0.9)[0, 0] == 3.0
    assert advantages(column(1), column(0), column(4), ended, ended, 0.5, 0.9)[0, 0] == 1.0


def test_the_value_that_follows_is_of_the_same_episode() -> None:
    values, last, ended = column(1, 2, 3), column(0, 7, 0), column(0, 1, 0).astype(bool)
    assert following_values(values, last, ended, np.array([4], np.float32))[:, 0].tolist() == [2, 7, 4]


def test_explained_variance_is_the_hand_computed_share() -> None:
    assert explained_variance(column(1, 2, 3), column(2, 4, 6)) == pytest.approx(0.75)  # errors 1, 2, 3 of 2, 4, 6
    assert math.isnan(explained_variance(column(1, 2), column(5, 5)))


class Endings:
    """Two made-up scenes of three decisions each, with rewards of 1: the first is cut off, the second crashes."""

    LENGTH = 3

    def __init__(self) -> None:
        self.parts = mixed_scenes(["two-way"], 0, scenes=2).parts
        self.age, self.returns = np.zeros(2, np.int64), np.zeros(2)

    def observe(self) -> tuple[np.ndarray, np.ndarray]:
        x = np.zeros((2, N_ROWS, len(FEATURES)), np.float32)
        x[:, 0, 0] = 1.0
        x[:, 0, 2] = self.age  # so that every state has its own value
        return x, np.ones((2, 5), np.bool_)

    def decide(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        self.age += 1
        over = self.age == self.LENGTH
        return np.ones(2, np.float32), over & [False, True], over & [True, False]

    def reset(self, which: np.ndarray) -> None:
        self.age[which] = 0


@pytest.fixture
def first_batch(tmp_path, monkeypatch) -> tuple[tuple[np.ndarray, ...], np.ndarray, ActorCritic]:
    """What `train` hands to `advantages` in `Endings`, what it gets, and the network that it began with."""
    seen = []

    def spy(*given):
        seen.append((given, advantages(*given)))
        return seen[-1][1]

    monkeypatch.setattr(training, "advantages", spy)
    train(cast(Mixed, Endings()), tmp_path / "p.safetensors", steps=32, seed=0, progress=lambda *_: None)
    torch.manual_seed(0)
    return *seen[0], ActorCritic()


def test_training_bootstraps_an_episode_that_is_cut_off_with_the_value_of_its_last_state(first_batch) -> None:
    (_, values, next_values, *_), result, net = first_batch
    left = Endings()
    left.age[:] = left.LENGTH
    with torch.no_grad():
        last = net(torch.from_numpy(left.observe()[0]))[1][0].item()
    assert next_values[2, 0] == pytest.approx(last, abs=1e-6)
    assert last != pytest.approx(values[3, 0])  # the next row is of the next episode
    assert result[2, 0] == pytest.approx(1.0 + 0.99 ** (DECISION_TICKS / HZ) * last - values[2, 0], abs=1e-5)


def test_training_adds_nothing_after_a_crash(first_batch) -> None:
    (_, values, *_), result, _ = first_batch
    assert result[2, 1] == pytest.approx(1.0 - values[2, 1], abs=1e-6)


def test_directives_are_drawn_again_during_an_episode() -> None:
    scenes = mixed_scenes(["highway"], 0, scenes=32).parts[0]
    told = scenes.v_des.copy()
    for _ in range(10):
        scenes.decide(np.full(32, int(MetaAction.CRUISE)))
    assert 0 < np.sum(scenes.v_des != told) < 32


def test_closed_actions_have_no_probability():
    dist = masked_distribution(torch.zeros(1, 5), torch.tensor([[True, True, False, False, False]]))
    assert dist.probs[0].tolist() == [0.5, 0.5, 0.0, 0.0, 0.0]


class Table(torch.nn.Module):
    """The same five preferences and the same value for every state."""

    def __init__(self) -> None:
        super().__init__()
        self.logits, self.value = (torch.nn.Parameter(torch.zeros(n)) for n in (5, 1))

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.logits.expand(len(x), 5), self.value.expand(len(x))


def updated(log_ratio: float = 0.0, **config: Any) -> tuple[Table, dict[str, float]]:
    """One step of size 1 on two decisions, actions 0 and 1, whose advantages are 1 and -1 and value targets 1 and 3."""
    net = Table()
    batch = {
        "x": torch.zeros(2, 1),
        "is_open": torch.ones(2, 5, dtype=torch.bool),
        "action": torch.tensor([0, 1]),
        "log_prob": torch.full((2,), math.log(0.2) - log_ratio),
        "advantage": torch.tensor([1.0, -1.0]),
        "value_target": torch.tensor([1.0, 3.0]),
    }
    settings = LearnerConfig(epochs=1, max_grad_norm=1e9, **config)
    return net, update(
        cast(ActorCritic, net), torch.optim.SGD(net.parameters(), lr=1.0), settings, batch, torch.Generator()
    )


def test_an_update_follows_the_hand_computed_policy_gradient():
    # advantages / their deviation, sqrt(2): +-0.7071; -grad = mean of a * (onehot - p), in which p cancels
    net, _ = updated()
    assert net.logits.tolist() == pytest.approx([0.35355, -0.35355, 0, 0, 0], abs=1e-5)


def test_an_update_follows_the_hand_computed_value_gradient():
    net, _ = updated(value_weight=0.25)  # -0.25 * mean of 2 (0 - 1) and 2 (0 - 3)
    assert net.value.item() == pytest.approx(1.0)


@pytest.mark.parametrize(("target_kl", "steps"), [(0.204, 0), (0.206, 1)])
def test_an_update_stops_where_the_hand_computed_divergence_leaves_the_trust_region(target_kl, steps):
    _, figures = updated(log_ratio=math.log(2.0), target_kl=target_kl)  # 2 - 1 - ln 2 = 0.30685 = 1.5 * 0.20457
    assert (figures["updates"], figures["approx_kl"]) == (steps, pytest.approx(0.30685, abs=1e-5))


def test_a_preference_that_has_grown_enough_is_not_pushed_further():
    net, _ = updated(log_ratio=math.log(1.3), clip=0.2, target_kl=1.0)  # only action 1 still pulls: -a r (e1 - p) / 2
    pull = -0.7071 * 1.3 / 2
    assert net.logits.tolist() == pytest.approx([-0.2 * pull, 0.8 * pull, *[-0.2 * pull] * 3], abs=1e-4)


def test_an_update_reports_the_hand_computed_entropy_and_share_of_clipped_ratios() -> None:
    _, figures = updated(log_ratio=math.log(1.3), clip=0.2, target_kl=1.0)
    assert (figures["entropy"], figures["clipfrac"]) == (pytest.approx(math.log(5)), 1.0)


@pytest.mark.parametrize("layers", [1, 2])
def test_the_exported_policy_answers_as_torch_does(tmp_path, layers):
    torch.manual_seed(3)
    export(ActorCritic(layers=layers), tmp_path / "p.safetensors", {}, observations=50)  # raises when they differ
    assert load_attention(tmp_path / "p.safetensors").sidecar["layers"] == layers


def test_an_export_whose_weights_differ_is_refused(tmp_path, monkeypatch) -> None:
    net = ActorCritic()

    def another(path):
        policy = load_attention(path)
        policy._last_bias[0] += 0.01
        return policy

    monkeypatch.setattr(training, "load_attention", another)
    with pytest.raises(ValueError, match="differs"):
        export(net, tmp_path / "p.safetensors", {}, observations=10)


def test_a_policy_whose_sidecar_names_another_number_of_layers_is_refused(tmp_path) -> None:
    path = tmp_path / "p.safetensors"
    export(ActorCritic(layers=2), path, {}, observations=1)
    sidecar = json.loads(path.with_suffix(".json").read_text())
    path.with_suffix(".json").write_text(json.dumps({**sidecar, "layers": 1}))
    with pytest.raises(ConfigError, match="2 layers"):
        load_attention(path)


def test_the_policy_does_not_depend_on_the_order_of_the_other_vehicles():
    policy = load_attention()
    x = np.random.default_rng(0).normal(size=(15, len(FEATURES))).astype(np.float32)
    x[:, 0] = 1.0
    shuffled = np.concatenate([x[:1], np.random.default_rng(1).permutation(x[1:])])
    assert np.allclose(policy.logits(x), policy.logits(shuffled), atol=1e-4)


def test_the_attention_of_each_head_sums_to_one_and_leaves_absent_vehicles_out():
    x = np.random.default_rng(0).normal(size=(15, len(FEATURES))).astype(np.float32)
    x[:, 0] = np.arange(15) < 6
    attention = load_attention().attention(x)
    assert attention.shape == (2, 15)
    assert np.allclose(attention.sum(-1), 1.0, atol=1e-5)
    assert not attention[:, 6:].any()


def test_a_policy_for_other_features_is_refused_with_the_fix(tmp_path):
    path = tmp_path / "p.safetensors"
    export(ActorCritic(), path, {}, observations=1)
    sidecar = json.loads(path.with_suffix(".json").read_text())
    path.with_suffix(".json").write_text(json.dumps({**sidecar, "layout_hash": "other"}))
    with pytest.raises(ConfigError, match="train anew"):
        load_attention(path)


def test_a_missing_or_unsigned_policy_is_refused_in_one_line(tmp_path):
    with pytest.raises(ConfigError, match="fastslow train"):
        load_attention(tmp_path / "none.safetensors")
    (tmp_path / "bad.json").write_text("{}")
    (tmp_path / "bad.safetensors").write_bytes(b"not weights")
    with pytest.raises(ConfigError, match="no digest"):
        load_attention(tmp_path / "bad.safetensors")


def test_the_wish_and_the_neighbours_stand_where_the_layout_says():
    rows = np.zeros((2, 9), np.float32)
    rows[0, 1:4], rows[1, :4] = (100, 4, 5), (1, 125, 0, -5)
    x = features(rows.tolist(), 0.0, 8.0, 1.5, 6.0, False, 150.0)
    own, other = dict(zip(FEATURES, x[0], strict=True)), dict(zip(FEATURES, x[1], strict=True))
    assert (own["y_des"], round(float(own["v_des"]), 3), own["headway"], round(float(own["set_point"]), 3)) == (
        -1.0,
        0.6,
        0.5,
        0.2,
    )
    assert (other["dx"], other["dy"], other["oncoming"], other["is_ego"]) == (0.5, -1.0, 1.0, 0.0)
    assert (own["y_wished"], own["road_left"]) == (1.0, 1.5)
    assert not x[2:].any()


def test_without_a_wished_lane_the_lateral_wish_is_zero_and_says_so():
    rows = np.zeros((1, 9), np.float32)
    x = features(rows.tolist(), np.nan, 8.0, 1.5, 6.0, False, 150.0)
    assert [x[0, FEATURES.index(name)] for name in ("y_des", "y_wished")] == [0.0, 0.0]


def test_a_damaged_state_to_resume_from_is_refused_in_one_line(tmp_path):
    for damaged in (b"", b"not a state", b"PK\x03\x04"):
        (tmp_path / "p.train.pt").write_bytes(damaged)
        with pytest.raises(ConfigError, match="corrupt"):
            training.saved_state(tmp_path / "p.safetensors")
