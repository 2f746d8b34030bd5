"""PPO, A2C and DQN of stable-baselines3 and MaskablePPO of sb3-contrib on the very scenes that ours learns on (extra
`train`).

Tuned fairly: scaled rewards, our learning rate and discount, two layers of 128, DQN with a gradient
step per four transitions. The variants differ in their scenes and here:

* `bare`, as published: no mask, and the wish's columns are zero. Its scenes should ask for one and the same thing.
* `masked`: behind our mask, with the wish in their observation. They learn which actions are closed from what becomes
  of them (CRUISE, where that is open); when they drive, the best open one is taken, as of ours.
* `mask-only`, `wish-only`: with one of the two. Behind the mask alone, no action is closed for a wish.

MaskablePPO, with PPO's settings, is told which actions are closed and never chooses them; so it has no `bare` variant.
"""

from __future__ import annotations

import inspect
import math
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from sb3_contrib import MaskablePPO
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from fast_node.mask import VERSION as MASK_VERSION
from fast_node.policies.checkpoint import write_checkpoint
from fast_node.policies.mlp import WISH, MlpPolicy, load_mlp, masked, told
from fast_node.training.log import Log
from fast_node.training.mixed import Mixed
from fast_node.training.train import DECISION_S, Logits, conditions, random_inputs
from schemas.driving.features import BOUND, FEATURES, LAYOUT_HASH, N_ROWS, Array
from schemas.runtime.process import revision
from schemas.wire.messages import POLICY_ACTIONS, MetaAction

COMMON = {"gamma": 0.99**DECISION_S, "learning_rate": 5e-4}
CONFIG: dict[str, dict[str, Any]] = {
    "ppo": {"n_steps": 32, "batch_size": 256, "n_epochs": 10, "target_kl": 0.03, "ent_coef": 0.01},
    "a2c": {"n_steps": 8, "ent_coef": 0.01},
    "dqn": {
        "batch_size": 64,
        "buffer_size": 100_000,
        "learning_starts": 1000,
        "train_freq": 1,
        "gradient_steps": 4,
        "target_update_interval": 1000,
        "exploration_fraction": 0.2,
    },
}
"""Where the search began: apart from stable-baselines3's defaults, for 64 (PPO) and 16 scenes at once."""
TRIALS: dict[str, dict[str, dict[str, Any]]] = {
    "ppo": {
        "start": {},
        "lr-2.5e-4": {"learning_rate": 2.5e-4},
        "lr-1e-3": {"learning_rate": 1e-3},
        "no-entropy": {"ent_coef": 0.0},
        "no-kl-limit": {"target_kl": None},
        "short-rollouts": {"n_steps": 8, "batch_size": 128},
    },
    "a2c": {
        "start": {},
        "lr-2.5e-4": {"learning_rate": 2.5e-4},
        "lr-1e-3": {"learning_rate": 1e-3},
        "gae": {"n_steps": 16, "gae_lambda": 0.95},
        "normalised": {"normalize_advantage": True},
        "adam": {"use_rms_prop": False},
    },
    "dqn": {
        "start": {},
        "lr-1e-4": {"learning_rate": 1e-4},
        "lr-2.5e-4": {"learning_rate": 2.5e-4},
        "explore-half": {"exploration_fraction": 0.5},
        "slow-target": {"target_update_interval": 5000},
    },
}
"""What `fastslow study --tune` compares: changes of CONFIG, one at a time."""
CHOSEN = {"ppo": "lr-1e-3", "a2c": "start", "dqn": "slow-target"}
"""The best of each in that comparison."""
_ADAM: dict[str, dict[str, Any]] = {
    "ppo": {"optimizer_kwargs": {"eps": 1e-5, "fused": True}},
    "a2c": {},
    "dqn": {"optimizer_kwargs": {"fused": True}},
}
"""The same Adam, computed faster; 1e-5 is PPO's own."""
CONFIG["maskable-ppo"], TRIALS["maskable-ppo"] = CONFIG["ppo"], TRIALS["ppo"]
CHOSEN["maskable-ppo"], _ADAM["maskable-ppo"] = CHOSEN["ppo"], _ADAM["ppo"]
KINDS: dict[str, Any] = {"ppo": PPO, "a2c": A2C, "dqn": DQN, "maskable-ppo": MaskablePPO}
OURS_TO_SAY = {"self", "policy", "env", "seed", "device", "verbose", "tensorboard_log", "policy_kwargs"}
"""Arguments of stable-baselines3 that are no settings."""
COUNTS = {
    *("n_steps", "batch_size", "n_epochs", "buffer_size", "train_freq", "gradient_steps"),
    *("target_update_interval", "stats_window_size"),
}
SHARES = {"gamma", "gae_lambda", "tau", "exploration_fraction", "exploration_initial_eps", "exploration_final_eps"}
POSITIVE = {"learning_rate", "clip_range", "clip_range_vf", "target_kl", "max_grad_norm", "rms_prop_eps"}
WIDTH = 128
LOG_EVERY = 1024
"""Decisions between two rows of figures."""


class VecScenes(VecEnv):
    """`Mixed` scenes as stable-baselines3 wants them: flat observations (S, N*F), resets inside `step`."""

    def __init__(self, scenes: Mixed, variant: str) -> None:
        self._scenes, self._told = scenes, told(variant)
        self.episodes: list[tuple[float, bool]] = []
        """(return, crashed) of every finished episode."""
        x, self._open = scenes.observe()
        super().__init__(
            len(x), spaces.Box(-BOUND, BOUND, (N_ROWS * len(FEATURES),), np.float32), spaces.Discrete(POLICY_ACTIONS)
        )

    def _see(self) -> Array:
        x, self._open = self._scenes.observe()
        if not self._told:
            x[:, 0, WISH] = 0.0
        return x.reshape(len(x), -1)

    def reset(self) -> Array:
        self._scenes.reset(np.ones(self.num_envs, np.bool_))
        return self._see()

    def step_async(self, actions: NDArray[np.int64]) -> None:
        self._actions = np.asarray(actions, np.int64)

    def step_wait(self) -> tuple[Array, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        closed = ~self._open[np.arange(self.num_envs), self._actions]
        earned, terminated, truncated = self._scenes.decide(np.where(closed, int(MetaAction.CRUISE), self._actions))
        done = terminated | truncated
        seen = self._see()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            returns = self._scenes.returns
            for s in np.flatnonzero(done):
                self.episodes.append((float(returns[s]), bool(terminated[s])))
                infos[s] = {"terminal_observation": seen[s], "TimeLimit.truncated": bool(truncated[s])}
            self._scenes.reset(done)
            seen = self._see()
        return seen, earned, done, infos

    def metrics(self) -> dict[str, float]:
        """Means of the last 200 episodes; empty before the first."""
        if not (last := self.episodes[-200:]):
            return {}
        returns, crashes = np.array(last).T
        return {"episodic_return": float(returns.mean()), "crash_rate": float(crashes.mean())}

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [None] * self.num_envs  # asked for the render mode only

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        if method_name != "action_masks":
            raise NotImplementedError
        return list(self._open | ~self._open.any(-1, keepdims=True))  # none is open: it brakes, whatever is chosen

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


class _Watch(BaseCallback):
    def __init__(self, told: Callable[[int], None]) -> None:
        super().__init__()
        self._told = told

    def _on_step(self) -> bool:
        self._told(self.num_timesteps)
        return True


def settings_of(algorithm: str, trial: str = "") -> dict[str, Any]:
    """What stable-baselines3 is told, by the chosen or the named trial. Raises KeyError for unknown names."""
    return {**COMMON, **CONFIG[algorithm], **TRIALS[algorithm][trial or CHOSEN[algorithm]]}


def known_settings(algorithm: str) -> list[str]:
    """The settings of stable-baselines3 that may be changed."""
    names = inspect.signature(KINDS[algorithm].__init__).parameters
    return [n for n in names if n not in OURS_TO_SAY and n[0] != "_" and not n.endswith(("_class", "_kwargs"))]


def check_settings(changes: Mapping[str, Any], steps: int) -> None:
    """Raise ValueError for a number with which nothing, or nonsense, would be learned: the library takes most of them.

    What is no number is left to the library to refuse.
    """
    for name, value in changes.items():
        if not isinstance(value, int | float):
            continue
        wanted = ""
        if name in COUNTS:
            every = name == "gradient_steps" and value == -1  # as many as there were transitions
            if not ((isinstance(value, int) and value >= 1) or every):
                wanted = "a whole number above 0"
        elif name in SHARES and not 0 <= value <= 1:
            wanted = "within 0..1"
        elif name in POSITIVE and not 0 < value < math.inf:
            wanted = "a positive number"
        elif name == "learning_starts" and not 0 <= value < steps:
            wanted = f"within 0..{steps - 1}, before the last step"
        elif not math.isfinite(value):
            wanted = "a finite number"
        if wanted:
            raise ValueError(f"{name} {value} is not {wanted}")


def learn(
    algorithm: str,
    scenes: Mixed,
    out: Path,
    *,
    variant: str,
    steps: int,
    seed: int,
    trial: str = "",
    changes: Mapping[str, Any] | None = None,
    watch: Callable[[int, Logits], None] = lambda *_: None,
    logs: AbstractContextManager[Log] | None = None,
) -> dict[str, float]:
    """Train one of `LEARNERS` for `steps` decisions and export it to `out` (.safetensors) for
    `fast_node.policies.mlp`.

    trial: one of TRIALS, instead of the chosen one; changes: of these settings, by their names in stable-baselines3.

    Returns the mean return and the share of crashes of its last 200 episodes, if any came to an end. Raises ValueError
    for a setting that is of no use.

    `watch` is called with the decisions made so far and the policy of that moment, before the first and after each;
    the log that `logs` opens, once nothing is refused any more, with them and the figures of that moment, now and then.
    """
    check_settings(changes or {}, steps)
    torch.set_num_threads(1)
    env = VecScenes(scenes, variant)
    settings = {**settings_of(algorithm, trial), **(changes or {})}
    try:
        model = KINDS[algorithm](
            "MlpPolicy",
            env,
            seed=seed,
            device="cpu",
            **settings,
            policy_kwargs={"net_arch": [WIDTH, WIDTH], **_ADAM[algorithm]},
        )
    except (TypeError, AssertionError, MemoryError) as error:
        raise ValueError(f"{algorithm} does not take {changes}: {error}") from None
    sidecar = {"algorithm": algorithm, "variant": variant, "activation": "relu" if algorithm == "dqn" else "tanh"}

    def now(x: Array) -> Array:
        return MlpPolicy(weights_of(model), sidecar).logits(x)

    watch(0, now)
    started, logged = time.perf_counter(), 0

    def after(done: int) -> None:
        nonlocal logged
        watch(done, now)
        if done // LOG_EVERY > logged and (metrics := env.metrics()):
            logged = done // LOG_EVERY
            log(done, {**metrics, "SPS": done / (time.perf_counter() - started)})

    with logs or nullcontext(lambda *_: None) as log:
        model.learn(steps, callback=_Watch(after))
    metrics = {name: round(value, 4) for name, value in env.metrics().items()}
    export(
        model,
        out,
        {
            **sidecar,
            "mask": MASK_VERSION if masked(variant) else None,
            "steps": model.num_timesteps,
            "seed": seed,
            **conditions(scenes),
            "learner": settings,
            "revision": revision(),
            "metrics": metrics,
        },
    )
    return metrics


def weights_of(model: Any) -> dict[str, Array]:
    """The linear layers from observation to preferences, in order: "0.weight", "0.bias", "1.weight", ..."""
    policy = model.policy
    body = [policy.q_net.q_net] if isinstance(model, DQN) else [policy.mlp_extractor.policy_net, policy.action_net]
    layers = [m for part in body for m in part.modules() if isinstance(m, torch.nn.Linear)]
    return {
        f"{k}.{name}": np.ascontiguousarray(getattr(layer, name).detach().numpy())
        for k, layer in enumerate(layers)
        for name in ("weight", "bias")
    }


def export(model: Any, out: Path, sidecar: dict[str, object], observations: int = 1000) -> None:
    """Write weights and sidecar, and check the NumPy policy against torch; raises `ValueError` beyond 1e-5
    of the largest value."""
    write_checkpoint(
        out, weights_of(model), {"layout_hash": LAYOUT_HASH, "features": FEATURES, "width": WIDTH, **sidecar}
    )
    x = random_inputs(observations)
    seen = x.copy()
    if not told(str(sidecar["variant"])):
        seen[:, 0, WISH] = 0.0
    flat = torch.from_numpy(seen.reshape(observations, -1))
    with torch.no_grad():
        policy = model.policy
        expected = policy.q_net(flat) if isinstance(model, DQN) else policy.get_distribution(flat).distribution.logits
    got = load_mlp(out).logits(x)
    if not isinstance(model, DQN):  # torch's are normalised
        got = got - np.log(np.exp(got).sum(-1, keepdims=True))
    worst = float(np.abs(got - expected.numpy()).max()) / max(1.0, float(expected.abs().max()))
    if worst > 1e-5:
        raise ValueError(f"the exported policy differs from the trained one by {worst:.1e}")
