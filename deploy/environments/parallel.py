"""Several cars on one road, each with its own directive, by PettingZoo's parallel API.

The cars are egos of one `RoadWorld`, which the engine ticks: mask, intent, features and reward of each are those of
training.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from deploy.environments.config import Directive, Features, check_lane, check_seed, convert, read
from deploy.environments.episodes import Episodes, action_of, action_space, features_space, one_of
from deploy.environments.single import SEEDS
from deploy.environments.world import RoadWorld
from schemas.driving.episode import Ending
from schemas.driving.features import Array
from schemas.wire.messages import MetaAction
from sim_node.env import ScenarioEnv
from sim_node.scenarios import Scenario

DIRECTIVES = "directives"
APART = 1_000_003
"""Between the seeds of two cars' directives."""
Infos = dict[str, dict[str, Any]]


class DrivingParallelEnv(ParallelEnv):
    """`cars` egos on one road: the scenario's own, and the cars nearest to it that drive in its direction.

    A car terminates on a collision and stays where it stands; it truncates at the goal or the road's end, where it
    leaves the road, and when the time is up.
    """

    metadata = {"name": "fastslow_v0", "render_modes": ["rgb_array"], "is_parallelizable": True}

    def __init__(
        self,
        scenario: str | Scenario = "highway",
        cars: int = 3,
        *,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        """config, settings: as `DrivingEnv`. Raises ValueError, by name, for what cannot be done here."""
        self._config = read(config, settings)
        if not isinstance(self._config.observation, Features):
            raise ValueError(f"observation {type(self._config.observation).__name__} is for one car: here are Features")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode {render_mode!r} is not rgb_array")
        self.scenario = self._config.road(scenario)
        if not 1 <= cars <= self.scenario.vehicles_max:
            raise ValueError(f"cars {cars} is not within 1..{self.scenario.vehicles_max}, all that this road has")
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": self._config.decision_hz}
        self.possible_agents = [f"car_{k}" for k in range(cars)]
        self.agents: list[str] = []
        env = ScenarioEnv(self.scenario, decision_hz=self._config.decision_hz, duration_s=None, render_mode=render_mode)
        self._world = RoadWorld(env, cars)
        self._episodes = Episodes(self._world, self.scenario, self._config)
        self._generator: np.random.Generator | None = None
        # The API asks for the same object every time, and each car's has a generator of its own.
        self.observation_spaces = {car: features_space(self._config.flat) for car in self.possible_agents}
        self.action_spaces = {car: action_space() for car in self.possible_agents}

    def observation_space(self, agent: str) -> spaces.Box:
        """Of every car: the policy's input."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete[np.int64]:
        """Of every car: the five meta-actions."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Array], Infos]:
        """A new episode of all cars. options: {"directives": {car: {...}}}.

        Another option is left out with a warning, for PettingZoo's own test gives one. Raises ValueError for a car or a
        directive that is none, and for a seed whose cars' would be above 2**63 - 1.
        """
        check_seed(seed, APART * (len(self.possible_agents) - 1))
        said = self._directives(options)
        if seed is not None or self._generator is None:
            self._generator = seeding.np_random(seed)[0]
        number = int(self._generator.integers(SEEDS)) if seed is None else seed
        every = np.ones(len(self.possible_agents), np.bool_)
        self._episodes.begin(every, number + APART * np.arange(len(every)))
        self.agents = list(self.possible_agents)
        for car, directive in said.items():
            self._episodes.direct(self.possible_agents.index(car), directive)
        return self._seen()

    def step(
        self, actions: dict[str, int]
    ) -> tuple[dict[str, Array], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """One decision of every car that drives. Raises ValueError for what is no action, ResetNeeded where none
        drives."""
        if not self.agents:
            raise ResetNeeded("no car drives: call reset() first, and again once all have ended")
        if set(actions) != set(self.agents):
            raise ValueError(f"actions are of {sorted(actions)}, but these cars drive: {self.agents}")
        chosen = np.full(len(self.possible_agents), int(MetaAction.CRUISE))
        driving = {car: self.possible_agents.index(car) for car in self.agents}
        for car, k in driving.items():
            chosen[k] = action_of(actions[car])
        done = self._episodes.advance(chosen)
        seen, infos = self._seen()
        rewards = {car: float(done.earned[k]) for car, k in driving.items()}
        terminated = {car: bool(done.terminated[k]) for car, k in driving.items()}
        truncated = {car: bool(done.truncated[k]) for car, k in driving.items()}
        self._world.take_away(np.isin(self._episodes.happened, (Ending.GOAL, Ending.ROAD_END)))
        self.agents = [car for car in self.agents if not (terminated[car] or truncated[car])]
        return seen, rewards, terminated, truncated, infos

    def action_masks(self, agent: str) -> NDArray[np.bool_]:
        """(5,) what this car may do now; the same as `infos[agent]["action_mask"]`."""
        return np.asarray(self._episodes.usable()[self.possible_agents.index(agent)])

    def direct(self, agent: str, **directive: Any) -> None:
        """Set a car's directive, by the fields of `config.Directive`, from now to the end of the episode."""
        said: Directive = convert(directive, Directive)
        check_lane(self.scenario, said)
        self._episodes.direct(self.possible_agents.index(agent), said)

    def render(self) -> NDArray[np.uint8] | None:
        """(height, width, 3) of the road, from above the first car."""
        return self._world.env.render()

    def close(self) -> None:
        self._world.env.close()

    def _directives(self, options: Mapping[str, Any] | None) -> dict[str, Directive]:
        for name in options or {}:
            if name != DIRECTIVES:
                warnings.warn(f"no option {name!r}, it is left out: reset takes {DIRECTIVES!r}", stacklevel=3)
        said: dict[str, Directive] = {}
        for car, directive in (options or {}).get(DIRECTIVES, {}).items():
            if car not in self.possible_agents:
                raise ValueError(f"no car {car!r}: choose from {', '.join(self.possible_agents)}")
            said[car] = convert(directive, Directive)
            check_lane(self.scenario, said[car])
        return said

    def _seen(self) -> tuple[dict[str, Array], Infos]:
        x, told = self._episodes.seen(), self._episodes.told()
        where = {car: self.possible_agents.index(car) for car in self.agents}
        return {car: x[k] for car, k in where.items()}, {car: one_of(told, k) for car, k in where.items()}
