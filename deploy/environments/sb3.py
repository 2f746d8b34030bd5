"""Our vector environment as stable-baselines3 wants it, with the masks that sb3-contrib asks for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from deploy.environments.vector import DrivingVectorEnv
from schemas.driving.features import Array
from sim_node.scenarios import Scenario


class Sb3VecEnv(VecEnv):
    """`num_envs` roads at once; an ended episode is followed by the next at once, as this library has it."""

    def __init__(self, scenario: str | Scenario = "highway", num_envs: int = 16, **settings: Any) -> None:
        """settings: as `DrivingVectorEnv`."""
        self._env = DrivingVectorEnv(num_envs, scenario, autoreset_mode=AutoresetMode.SAME_STEP, **settings)
        super().__init__(num_envs, self._env.single_observation_space, self._env.single_action_space)
        self._returns, self._lengths = np.zeros(num_envs), np.zeros(num_envs, np.int64)

    def reset(self) -> Array:
        seed = self._seeds[0]
        seen, _ = self._env.reset(seed=None if seed is None else [int(s) for s in self._seeds if s is not None])
        self._reset_seeds()
        self._returns[:], self._lengths[:] = 0.0, 0
        return seen

    def step_async(self, actions: NDArray[np.int64]) -> None:
        self._actions = np.asarray(actions, np.int64)

    def step_wait(self) -> tuple[Array, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        seen, earned, terminated, truncated, told = self._env.step(self._actions)
        done = terminated | truncated
        self._returns += earned
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for s in np.flatnonzero(done):
            infos[s] = {
                "terminal_observation": told["final_obs"][s],
                "TimeLimit.truncated": bool(truncated[s]),
                "crashed": bool(terminated[s]),
                "episode": {"r": float(self._returns[s]), "l": int(self._lengths[s]), "t": 0.0},
            }
        self._returns[done], self._lengths[done] = 0.0, 0
        return seen, earned.astype(np.float32), done, infos

    def close(self) -> None:
        self._env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        if attr_name == "action_masks":  # sb3-contrib asks whether there is one
            return [self._env.action_masks] * len(self._chosen(indices))
        return [getattr(self._env, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError("an environment keeps its settings: make another one")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        if method_name != "action_masks":
            raise AttributeError(f"the roads have no method {method_name!r}")
        masks = self._env.action_masks()
        return [masks[s] for s in self._chosen(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * len(self._chosen(indices))

    def _chosen(self, indices: Any) -> Sequence[int]:
        return list(self._get_indices(indices))
