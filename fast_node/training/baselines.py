"""PPO, A2C and DQN of stable-baselines3 on the very scenes that ours learns on (extra `baselines`).

Tuned fairly: scaled rewards, the same network width, learning rate and discount, DQN with two gradient steps per eight
transitions. `masked` puts our mask between them and the world, as a guard: they choose, it corrects; without it they
drive as published. `directed` leaves the wish in their observation; without it they are asked for full speed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from fast_node.training.rollout import Mixed
from schemas.features import BOUND, FEATURES, N_ROWS, Array
from schemas.messages import POLICY_ACTIONS

LR, GAMMA, WIDTH = 5e-4, 0.99, 128
WISH = tuple(FEATURES.index(name) for name in ("y_des", "v_des", "headway", "y_wished"))


class VecScenes(VecEnv):
    """`Mixed` scenes as stable-baselines3 wants them: flat observations, resets inside `step`."""

    def __init__(self, scenes: Mixed, directed: bool) -> None:
        self._scenes, self._directed = scenes, directed
        self.episodes: list[tuple[float, bool]] = []
        """(return, crashed) of every finished episode."""
        shape = (N_ROWS * len(FEATURES),)
        super().__init__(len(scenes.observe()[0]), spaces.Box(-BOUND, BOUND, shape, np.float32),
                         spaces.Discrete(POLICY_ACTIONS))

    def _see(self) -> Array:
        return flat(self._scenes.observe()[0], self._directed)

    def reset(self) -> Array:
        self._scenes.reset(np.ones(self.num_envs, np.bool_))
        return self._see()

    def step_async(self, actions: NDArray[np.int64]) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Array, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        earned, terminated, truncated = self._scenes.decide(np.asarray(self._actions, np.int64))
        done = terminated | truncated
        seen = self._see()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            returns = self._scenes.returns
            for s in np.flatnonzero(done):
                self.episodes.append((float(returns[s]), bool(terminated[s])))
                infos[s] = {"terminal_observation": seen[s], "TimeLimit.truncated": bool(truncated[s]),
                            "episode": {"r": float(returns[s]), "l": 0, "t": 0.0}}
            self._scenes.reset(done)
            fresh = self._see()
            seen = np.where(done[:, None], fresh, seen)
        return seen, earned, done, infos

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


def flat(x: Array, directed: bool) -> Array:
    """(S, N, F) -> (S, N*F), without the wish where it is not for them to know."""
    if not directed:
        x = x.copy()
        x[:, 0, WISH] = 0.0
    return x.reshape(len(x), -1)


class _Progress(BaseCallback):
    def __init__(self, told: Callable[[int, list[tuple[float, bool]]], None]) -> None:
        super().__init__()
        self._told = told

    def _on_step(self) -> bool:
        if self.n_calls % 16 == 0:
            self._told(self.num_timesteps, self.training_env.episodes)  # type: ignore[attr-defined]
        return True


def learn(
    algorithm: str, scenes: Mixed, *, steps: int, seed: int, directed: bool, out: Path,
    progress: Callable[[int, list[tuple[float, bool]]], None] = lambda *_: None,
) -> None:
    """Train `ppo`, `a2c` or `dqn` for `steps` decisions and save it to `out` (.zip). Raises KeyError for others."""
    env = VecScenes(scenes, directed)
    net: dict[str, Sequence[int]] = {"net_arch": [WIDTH, WIDTH]}
    common: dict[str, Any] = {"gamma": GAMMA, "learning_rate": LR, "seed": seed, "device": "cpu", "policy_kwargs": net}
    n = env.num_envs
    make: dict[str, Callable[[], BaseAlgorithm]] = {
        "ppo": lambda: PPO("MlpPolicy", env, n_steps=max(2048 // n, 1), batch_size=256, n_epochs=10, target_kl=0.03,
                           ent_coef=0.01, **common),
        "a2c": lambda: A2C("MlpPolicy", env, n_steps=8, ent_coef=0.01, **common),
        "dqn": lambda: DQN("MlpPolicy", env, batch_size=64, buffer_size=100_000, learning_starts=1000, train_freq=1,
                           gradient_steps=max(n // 4, 1), target_update_interval=max(2000 // n, 1),
                           exploration_fraction=0.2, **common),
    }
    model = make[algorithm]()
    model.learn(steps, callback=_Progress(progress))
    model.save(out)


def logits_of(algorithm: str, path: Path, directed: bool) -> Callable[[Array], Array]:
    """The trained agent as preferences over actions: (S, N, F) -> (S, 5). Q values for DQN."""
    import torch

    kinds: dict[str, Any] = {"ppo": PPO, "a2c": A2C, "dqn": DQN}
    model = kinds[algorithm].load(path, device="cpu")

    def logits(x: Array) -> Array:
        with torch.no_grad():
            seen = torch.from_numpy(flat(x, directed))
            out = model.q_net(seen) if algorithm == "dqn" else model.policy.get_distribution(seen).distribution.logits
        return np.asarray(out.numpy(), np.float32)

    return logits
