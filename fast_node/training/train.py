"""`fastslow train`: learn one policy for several scenarios, export it as safetensors with a JSON sidecar.

The paper's equations, by the numbers that its source gives them, and where they are:

* Eq. 10  o_t = (o_env, y_des): the wish stands in the observation's ego row (`schemas.driving.features`); the
  directives are drawn in `rollout.Scenes`.
* Eq. 11  z^0 = f_embed(o_t);  Eq. 12  z^(l+1) = MHSA(z^l) + FFN(z^l);  Eq. 13  pi = softmax(W z^L + b): `network`.
* Eq. 14  V(s_t) = E[sum_k gamma^k r_(t+k)]: `ActorCritic.value`, learnt by Eq. 17.
* Eq. 15  A_t = sum_(k<K) gamma^k r_(t+k) + gamma^K V(s_(t+K)) - V(s_t): `learner.advantages`.
* Eq. 16  grad J = E[grad log pi(a_t | o_t) A_t], not far from the old policy;  Eq. 17  min E[(V - V_target)^2]:
  `learner.update`.

As the paper has them: two heads, width 128, gamma 0.99, learning rate 5e-4, 1e5 decisions. Where we depart from it:

* Wish: speed and headway beside y_des, which only the ego's row has; drawn at the start, and again during the episode.
* Encoder: normalised inputs and a residual term, z + MHSA(norm z) + FFN(norm z); one layer (the paper names no L).
* Readout: policy and value from the ego's row of z^L; the paper does not say of which. Both share the network below.
* Closed actions have no probability, in training as in driving; the paper's mask works at runtime only.
* Advantage: generalised, lambda 0.95, in the place of one K; an episode that is cut off is bootstrapped. V_target is
  this advantage plus V. Per minibatch it is brought to mean 0 and deviation 1.
* Policy: the clipped surrogate (0.2), several epochs over a batch, in the place of Eq. 16's plain gradient; its
  constraint is that an update ends where KL(old || new) leaves the trust region.
* Loss: one for policy and value (weight 0.5), with an entropy bonus (0.01); gradients are clipped to norm 0.5.
* The learning rate falls linearly to a tenth.
"""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from fast_node.mask import VERSION as MASK_VERSION
from fast_node.policies.attention import load_attention
from fast_node.policies.checkpoint import write_checkpoint
from fast_node.training.learner import (
    LearnerConfig,
    advantages,
    explained_variance,
    following_values,
    masked_distribution,
    update,
)
from fast_node.training.log import logged
from fast_node.training.mixed import Mixed
from fast_node.training.network import ActorCritic
from schemas.driving import reward as rewards
from schemas.driving.features import FEATURES, LAYOUT_HASH, N_ROWS, Array
from schemas.driving.road import DECISION_TICKS, HZ
from schemas.runtime.process import ConfigError, revision
from schemas.wire.text import plain

WIDTH, HEADS, LAYERS = 128, 2, 1
ROLLOUT = 16
"""Decisions of every scene between two updates."""
DECISION_S = DECISION_TICKS / HZ
"""The discount is that of a second."""
LR_END = 0.1
"""The learning rate falls linearly to this share of it."""
SAVE_EVERY = 10
"""Updates between two states to resume from."""

Logits = Callable[[Array], Array]
"""(S, N, F) -> (S, 5)"""


def train(
    scenes: Mixed,
    out: Path,
    *,
    steps: int,
    seed: int,
    progress: Callable[[int, dict[str, float]], None],
    config: LearnerConfig | None = None,
    resume: bool = False,
    start: dict[str, Any] | None = None,
    watch: Callable[[int, Logits], None] = lambda *_: None,
    track: bool = False,
) -> dict[str, float]:
    """Train for `steps` decisions and export to `out` (.safetensors). Returns the last figures.

    The learning rate falls linearly to a tenth: the policy that is exported is the last one. Beside `out` lie its
    sidecar (.json), the figures of every update (.progress.csv and, where tensorboard is installed, .tensorboard/) and
    the state to resume from (.train.pt). A resumed run goes on with network, optimizer, generators and step count; the
    worlds are the caller's, and start new episodes. `start`: `saved_state` of another run, with whose network this
    one begins, instead of a random one. `watch` is called with the decisions made so far and the policy of that moment,
    before the first and after each. `track`: keep a W&B run, too. Raises `ConfigError` for a state that is not this
    run's, or not of this code.
    """
    run = _Run(scenes, out, seed, config or LearnerConfig())
    if start is not None:
        run.begin_with(start)
    if resume:
        run.go_on(steps)
    figures: dict[str, float] = {}
    started, before = time.perf_counter(), run.done
    watch(run.done, run.logits)
    with logged(out, run.done, track=run.facts if track else None) as log:
        while run.done < steps:
            run.slow_down(steps)
            figures = run.update(run.roll_out(watch))
            figures["SPS"] = (run.done - before) / (time.perf_counter() - started)
            log(run.done, figures)
            progress(run.done, figures)
            if run.done >= steps or run.done // (ROLLOUT * len(run.x)) % SAVE_EVERY == 0:
                run.save()
    run.export(figures)
    return figures


class _Run:
    """One run of the learner: its network, how far it has got, and what stands in its sidecar."""

    def __init__(self, scenes: Mixed, out: Path, seed: int, config: LearnerConfig) -> None:
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        self._scenes, self._out, self._config = scenes, out, config
        self._generator = torch.Generator().manual_seed(seed)
        self.net = ActorCritic(WIDTH, HEADS, LAYERS)
        self._optimizer = torch.optim.Adam(self.net.parameters(), lr=config.lr, eps=1e-5, fused=True)
        self.facts = {
            "seed": seed,
            **conditions(scenes),
            "learner": asdict(config),
            "rollout": ROLLOUT,
            "lr_schedule": {"shape": "linear", "end": LR_END},
            **sidecar_of(scenes.parts[0].task.preset),
        }
        self.done, self._resumed_at = 0, list[int]()
        self._returns, self._crashes, self._lengths = list[float](), list[bool](), list[int]()
        self.x, self._open = scenes.observe()

    def begin_with(self, start: dict[str, Any]) -> None:
        """Take the network of another run. Raises `ConfigError` where it is of another code."""
        for name in ("layout_hash", "mask"):
            if (found := start["run"].get(name)) != self.facts[name]:
                raise ConfigError(
                    f"the run to start from has {name} {found!r}, this code {self.facts[name]!r}: train it anew"
                )
        self.net.load_state_dict(start["net"])
        self.facts["start"] = {"steps": start["steps"], **start["run"]}

    def go_on(self, steps: int) -> None:
        """Go on where this run was last saved. Raises `ConfigError` where that was another run, or is at its end."""
        saved, out = saved_state(self._out, resumable=True), self._out
        run = self.facts
        run |= {k: v for k, v in saved["run"].items() if k == "start"}
        self.done, self._resumed_at = saved["steps"], [*saved["resumed_at"], saved["steps"]]
        if (was := saved["run"]) != run:
            differs = [f"{k} {was.get(k)!r}, not {run.get(k)!r}" for k in {**was, **run} if was.get(k) != run.get(k)]
            raise ConfigError(
                f"{out.name} was trained with {'; '.join(differs)}: resume it with the same, or train anew"
            )
        if self.done >= steps:
            raise ConfigError(f"{out.name} has learnt from {self.done} decisions already: resume it with more --steps")
        self.net.load_state_dict(saved["net"])
        self._optimizer.load_state_dict(saved["optimizer"])
        torch.set_rng_state(saved["rng"])
        self._generator.set_state(saved["generator"])

    def logits(self, x: Array) -> Array:
        """The policy of this moment."""
        with torch.no_grad():
            return np.asarray(self.net(torch.from_numpy(x))[0].numpy())

    def slow_down(self, steps: int) -> None:
        """The learning rate of this moment."""
        for group in self._optimizer.param_groups:
            group["lr"] = self._config.lr * max(LR_END, 1.0 - self.done / steps)

    def roll_out(self, watch: Callable[[int, Logits], None]) -> dict[str, np.ndarray]:
        """Act: a_t ~ pi(. | o_t) over the open actions (Eq. 13), and V (Eq. 14); (ROLLOUT, S, ...) of each."""
        scenes, steps = self._scenes, list[dict[str, np.ndarray]]()
        for _ in range(ROLLOUT):
            x, is_open = self.x, self._open
            with torch.no_grad():
                logits, value = self.net(torch.from_numpy(x))
                dist = masked_distribution(logits, torch.from_numpy(is_open))
                action = dist.sample()
                log_prob = dist.log_prob(action)
            reward, terminated, truncated = scenes.decide(action.numpy())
            ended = terminated | truncated
            self.x, self._open = scenes.observe()
            last_value = np.zeros(len(x), np.float32)  # of the states that are left behind by a reset
            if ended.any():
                last_value[ended] = _values(self.net, self.x[ended])
                self._note(ended, terminated)
                scenes.reset(ended)
                self.x, self._open = scenes.observe()
            steps.append(
                {
                    "x": x,
                    "is_open": is_open,
                    "action": action.numpy(),
                    "log_prob": log_prob.numpy(),
                    "value": value.numpy(),
                    "last_value": last_value,
                    "reward": reward,
                    "terminated": terminated,
                    "ended": ended,
                }
            )
            self.done += len(x)
            watch(self.done, self.logits)
        return {k: np.stack([step[k] for step in steps]) for k in steps[0]}

    def _note(self, ended: np.ndarray, terminated: np.ndarray) -> None:
        self._returns += self._scenes.returns[ended].tolist()
        self._crashes += terminated[ended].tolist()
        self._lengths += self._scenes.age[ended].tolist()

    def update(self, b: dict[str, np.ndarray]) -> dict[str, float]:
        """V(o_{t+1}) of the same episode, advantages (Eq. 15) and value targets, then the update (Eq. 16, 17)."""
        config = self._config
        next_value = following_values(b["value"], b["last_value"], b["ended"], _values(self.net, self.x))
        advantage = advantages(
            b["reward"], b["value"], next_value, b["terminated"], b["ended"], config.gamma**DECISION_S, config.lam
        )
        flat = {k: torch.from_numpy(b[k].reshape(-1, *b[k].shape[2:])) for k in ("x", "is_open", "action", "log_prob")}
        used = int(np.flatnonzero(b["x"][..., 0].any((0, 1)))[-1]) + 1  # rows that are always absent cost time
        flat["x"] = flat["x"][:, :used]
        flat["advantage"] = torch.from_numpy(advantage.reshape(-1))
        flat["value_target"] = torch.from_numpy((advantage + b["value"]).reshape(-1))
        return {
            **update(self.net, self._optimizer, config, flat, self._generator),
            "explained_variance": explained_variance(b["value"], advantage + b["value"]),
            "episodic_return": _mean(self._returns),
            "crash_rate": _mean(self._crashes),
            "episodic_length": _mean(self._lengths),
            "learning_rate": self._optimizer.param_groups[0]["lr"],
        }

    def save(self) -> None:
        """Keep all that a resumed run needs."""
        path = self._out.with_suffix(".train.pt")
        state = {
            "run": self.facts,
            "steps": self.done,
            "resumed_at": self._resumed_at,
            "net": self.net.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "rng": torch.get_rng_state(),
            "generator": self._generator.get_state(),
        }
        torch.save(state, path.with_suffix(".new"))
        os.replace(path.with_suffix(".new"), path)

    def export(self, figures: dict[str, float]) -> None:
        """Write the policy of this moment and its sidecar."""
        export(
            self.net,
            self._out,
            {
                "algorithm": "ours",
                "steps": self.done,
                **self.facts,
                "resumed_at": self._resumed_at,
                "revision": revision(),
                "metrics": {k: round(v, 4) for k, v in figures.items() if k not in ("SPS", "learning_rate")},
            },
        )


def _mean(of: Sequence[float]) -> float:
    """Of the last 200 episodes; nan before the first."""
    return float(np.mean(of[-200:])) if of else float("nan")


def _values(net: ActorCritic, x: Array) -> Array:
    with torch.no_grad():
        return np.asarray(net(torch.from_numpy(x))[1].numpy())


def conditions(scenes: Mixed) -> dict[str, Any]:
    """What a policy learns in, for its sidecar: scenarios, scenes of each, and the reward's weights."""
    return {
        "scenarios": [part.task.name for part in scenes.parts],
        "scenes": [len(part.wish) for part in scenes.parts],
        "reward": {
            name.lower(): value for name, value in vars(rewards).items() if name.isupper() and isinstance(value, float)
        },
    }


def sidecar_of(preset: str) -> dict[str, Any]:
    """What a policy's sidecar says of the code that it was made for."""
    return {"mask_preset": preset, "mask": MASK_VERSION, "layout_hash": LAYOUT_HASH}


def export(net: ActorCritic, out: Path, sidecar: dict[str, object], observations: int = 1000) -> None:
    """Write weights and sidecar, and check the NumPy policy against torch; raises `ValueError` beyond 1e-5
    of the largest logit."""
    write_checkpoint(
        out,
        {k: v.numpy() for k, v in net.state_dict().items() if not k.startswith("value")},
        {
            "layout_hash": LAYOUT_HASH,
            "features": FEATURES,
            "mask": MASK_VERSION,
            "layers": len(net.layers),
            "heads": net.heads,
            "width": net.embed.out_features,
            **sidecar,
        },
    )
    policy = load_attention(out)
    x = random_inputs(observations)
    with torch.no_grad():
        expected = net(torch.from_numpy(x))[0].numpy()
    worst = max(float(np.abs(policy.logits(a) - b).max()) for a, b in zip(x, expected, strict=True))
    worst /= max(1.0, float(np.abs(expected).max()))
    if worst > 1e-5:
        raise ValueError(f"the exported policy differs from the trained one by {worst:.1e}")


def random_inputs(observations: int) -> Array:
    """(observations, N, F) normal numbers with about 70 % of the rows present, the ego always."""
    x = np.random.default_rng(0).normal(size=(observations, N_ROWS, len(FEATURES))).astype(np.float32)
    x[:, :, 0] = np.random.default_rng(1).random((observations, N_ROWS)) < 0.7
    x[:, 0, 0] = 1.0
    return x


RESUMED = ("optimizer", "rng", "generator", "resumed_at")
"""What a state has beyond the network, to go on as if nothing had happened. A taught policy's has not."""


def saved_state(out: Path, *, resumable: bool = False) -> dict[str, Any]:
    """What `train` left beside `out` to go on from; "steps": how far it got. Raises `ConfigError` without it, and
    where it is to be resumable and has no more than a network to start with."""
    path = out.with_suffix(".train.pt")
    if not path.exists():
        raise ConfigError(f"there is no {path.name} beside {out.name} to go on from: train without --resume or --start")
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True)
        _ = state["run"]["seed"], state["steps"], state["net"]
    except (OSError, EOFError, RuntimeError, ValueError, KeyError, TypeError, pickle.UnpicklingError) as error:
        why = plain(str(error), 100)
        raise ConfigError(f"{path.name} is corrupt ({why}): restore it, or train without --resume or --start") from None
    if resumable and not set(RESUMED) <= set(state):
        raise ConfigError(f"{path.name} has a network and no run to resume: begin with it by --start {out}")
    return state
