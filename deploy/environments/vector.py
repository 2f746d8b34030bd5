"""Many roads at once, as a Gymnasium vector environment: the very episodes of as many `DrivingEnv`, sooner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from deploy.environments.config import Features, check_seed, read
from deploy.environments.episodes import NAMES, Episodes, Step, action_space, directive_of, features_space
from deploy.environments.single import SEEDS
from deploy.environments.world import BatchedWorld, Bools, Ints
from schemas.driving.features import Array
from schemas.wire.messages import POLICY_ACTIONS
from sim_node.scenarios import Scenario

RESET_MASK = "reset_mask"
Steps = tuple[Array, NDArray[np.float64], Bools, Bools, dict[str, Any]]


class DrivingVectorEnv(VectorEnv[Array, Ints, NDArray[Any]]):
    """`num_envs` roads in the batched engine. Scene k of `reset(seed=s)` is `DrivingEnv`'s episode s + k."""

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "highway",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        """autoreset_mode: any of Gymnasium's; scenario, config, settings: as `DrivingEnv`.

        Raises ValueError, by name, for what is no setting or cannot be done here.
        """
        self._config = read(config, settings)
        if not isinstance(self._config.observation, Features):
            kind = type(self._config.observation).__name__
            raise ValueError(
                f"observation {kind} is for vectorization_mode='sync' or 'async': the engine sees Features"
            )
        if render_mode is not None:
            raise ValueError("many roads at once are not rendered: use vectorization_mode='sync'")
        if num_envs < 1:
            raise ValueError(f"num_envs {num_envs} is not a positive number")
        self.mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.mode}
        self.num_envs, self.scenario = num_envs, self._config.road(scenario)
        self.single_observation_space, self.single_action_space = features_space(self._config.flat), action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._episodes = Episodes(BatchedWorld(self.scenario, num_envs, 0), self.scenario, self._config)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._ended = np.ones(num_envs, np.bool_)
        """(S,) scenes that have to be reset before their next decision."""

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """New episodes; seed: of the first scene, or one for each. options: {"directive": {...}} and Gymnasium's
        {"reset_mask": (num_envs,) bool}. Raises ValueError for others, and for seeds above 2**63 - 1."""
        asked = dict(options or {})
        which = self._mask(asked.pop(RESET_MASK, None))
        directive = directive_of(asked, self.scenario)
        if isinstance(seed, int | np.integer):
            check_seed(int(seed), self.num_envs - 1)
        seeds = (
            [int(seed) + k for k in range(self.num_envs)]
            if isinstance(seed, int | np.integer)
            else list(seed)
            if seed is not None
            else [None] * self.num_envs
        )
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds for {self.num_envs} environments")
        for scene in np.flatnonzero(which):
            check_seed(seeds[scene])
            if seeds[scene] is not None:
                self._generators[scene] = seeding.np_random(seeds[scene])[0]
        self._begin(which, seeds, directive)
        return self._episodes.seen(), self._infos(self._episodes.told(), which)

    def step(self, actions: Ints) -> Steps:
        """One decision in every scene; where an episode has ended, see `metadata["autoreset_mode"]`.

        Raises ValueError for what are no actions, and for a scene that has ended where autoreset is disabled.
        """
        chosen = np.asarray(actions)
        whole = chosen.shape == (self.num_envs,) and chosen.dtype.kind in "iu"
        if not whole or chosen.min() < 0 or chosen.max() >= POLICY_ACTIONS:
            raise ValueError(f"actions {actions!r} are not {self.num_envs} whole numbers out of: {NAMES}")
        waiting = self._ended
        if waiting.any() and (self.mode == AutoresetMode.DISABLED or None in self._generators):
            raise ValueError(f"scene {int(np.argmax(waiting))} has no episode: reset it first (options {RESET_MASK!r})")
        done = self._episodes.advance(chosen.astype(np.int64))
        if self.mode == AutoresetMode.NEXT_STEP and waiting.any():
            self._begin(waiting, [None] * self.num_envs, None)
            on = ~waiting
            done = Step(np.where(on, done.earned, 0.0).astype(np.float32), done.terminated & on, done.truncated & on)
        self._ended = done.ended
        seen, told = self._episodes.seen(), self._episodes.told()
        final: dict[str, Any] = {}
        if self.mode == AutoresetMode.SAME_STEP and self._ended.any():
            ended = self._ended
            final = self._final(seen, told, ended)
            self._begin(ended, [None] * self.num_envs, None)
            seen, told = self._episodes.seen(), self._episodes.told()
        infos = {**final, **self._infos(told, np.ones(self.num_envs, np.bool_))}
        return seen, done.earned.astype(np.float64), done.terminated, done.truncated, infos

    def action_masks(self) -> Bools:
        """(num_envs, 5) what may be chosen now; the same as `infos["action_mask"]`."""
        return self._episodes.usable()

    def _mask(self, asked: Any) -> Bools:
        if asked is None:
            return np.ones(self.num_envs, np.bool_)
        mask = np.asarray(asked)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"{RESET_MASK} is not an array of {self.num_envs} booleans, one of them True")
        return mask

    def _begin(self, which: Bools, seeds: Sequence[int | None], directive: Any) -> None:
        numbers = np.zeros(self.num_envs, np.int64)
        for scene in np.flatnonzero(which):
            if (number := seeds[scene]) is None:
                generator = self._generators[scene] or seeding.np_random(None)[0]
                self._generators[scene], number = generator, int(generator.integers(SEEDS))
            numbers[scene] = number
        self._episodes.begin(which, numbers, directive)
        self._ended = self._ended & ~which

    def _infos(self, told: Mapping[str, Any], which: Bools) -> dict[str, Any]:
        """As Gymnasium groups the `info` of single environments: a mask `_name` beside every `name`."""
        out: dict[str, Any] = {}
        for name, value in told.items():
            if isinstance(value, dict):
                out[name] = self._infos(value, which)
            else:
                out[name] = np.where(which.reshape(-1, *[1] * (value.ndim - 1)), value, np.zeros(1, value.dtype))
            out[f"_{name}"] = which.copy()
        return out

    def _final(self, seen: Array, told: Mapping[str, Any], ended: Bools) -> dict[str, Any]:
        last = np.full(self.num_envs, None, dtype=object)
        for scene in np.flatnonzero(ended):
            last[scene] = seen[scene].copy()
        return {
            "final_obs": last,
            "_final_obs": ended.copy(),
            "final_info": self._infos(told, ended),
            "_final_info": ended.copy(),
        }
