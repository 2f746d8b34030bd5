"""One car on one road, as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import msgspec
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from deploy.environments.config import (
    Directive,
    Features,
    Kinematics,
    OccupancyGrid,
    check_lane,
    check_seed,
    convert,
    read,
)
from deploy.environments.episodes import Episodes, action_of, action_space, directive_of, features_space, one_of
from deploy.environments.world import BatchedWorld, RoadWorld, SeededWorld, one_road
from sim_node.scenarios import Scenario

SEEDS = 2**31
BOUNDED = {"presence", "x", "y", "vx", "vy", "cos_h", "sin_h", "on_road"}
"""Features of highway-env's that lie within -1 and 1 once they are scaled and clipped."""
_ALL = np.ones(1, np.bool_)
Observation = NDArray[Any]


class DrivingEnv(gymnasium.Env[Observation, int]):
    """The world that `fastslow train` learns in, one decision at a time: `docs/gymnasium.md` has all of it.

    Terminates on a collision; truncates at the goal, the road's end, or when the time is up.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 3}

    def __init__(
        self,
        scenario: str | Scenario = "highway",
        *,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        """scenario: a name, a FILE.toml or your own; config, settings: see `config.EnvConfig`.

        Raises ValueError, by name, for what is no setting or cannot be done on this road.
        """
        self._config = read(config, settings)
        self.scenario = self._config.road(scenario)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r} is not one of: rgb_array, human")
        self.render_mode = render_mode
        seen = self._config.observation
        self._road: RoadWorld | None = None
        """Only where pictures or highway-env's own observations are made of it; else the batched engine is faster."""
        if render_mode is not None or not isinstance(seen, Features):
            asked = {k: list(v) if k == "features" else v for k, v in msgspec.structs.asdict(seen).items()}
            asked.pop("as_image", None)  # see `_image`
            kind = {"type": type(seen).__struct_config__.tag, **asked}
            self._road = one_road(self.scenario, kind, render_mode, self._config.decision_hz)
        world: SeededWorld = self._road or BatchedWorld(self.scenario, 1, 0)
        self.metadata = {**self.metadata, "render_fps": self._config.decision_hz}
        self.action_space: Any = action_space()
        self.observation_space = features_space(self._config.flat)
        self._observed_by: Any = None
        if self._road is not None and not isinstance(seen, Features):
            self.observation_space = _bounded(self._road.env.observation_space, seen)
            self._observed_by = self._road.env
        self._as_image = isinstance(seen, OccupancyGrid) and seen.as_image
        self._episodes = Episodes(world, self.scenario, self._config)
        self._running = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """A new episode: with a seed that very one, without one the next of this environment's own.

        options: {"directive": {...}}, for this episode. Raises ValueError for others, and for a seed above 2**63 - 1.
        """
        check_seed(seed)
        super().reset(seed=seed)
        directive = directive_of(options, self.scenario)
        number = int(self.np_random.integers(SEEDS)) if seed is None else seed
        self._episodes.begin(_ALL, np.array([number]), directive)
        self._running = True
        if self.render_mode == "human":
            self.render()
        return self._observed(), self._info()

    def step(self, action: int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One decision. Raises ValueError for what is no action, ResetNeeded before `reset` and after the end."""
        if not self._running:
            raise ResetNeeded("no episode is running: call reset() first, and again after its end")
        done = self._episodes.advance(np.array([action_of(action)]))
        terminated, truncated = bool(done.terminated[0]), bool(done.truncated[0])
        self._running = not (terminated or truncated)
        if self.render_mode == "human":
            self.render()
        return self._observed(), float(done.earned[0]), terminated, truncated, self._info()

    def action_masks(self) -> NDArray[np.bool_]:
        """(5,) what may be chosen now, as MaskablePPO asks for it; the same as `info["action_mask"]`."""
        open_now: NDArray[np.bool_] = self._episodes.usable()[0]
        return open_now

    def direct(
        self, lane: int | None = None, speed_mps: float | None = None, headway_s: float = 1.5, overtake: bool = False
    ) -> None:
        """Set the directive from now to the end of the episode. Raises ValueError for a lane that does not exist."""
        said = {"lane": lane, "speed_mps": speed_mps, "headway_s": headway_s, "overtake": overtake}
        directive: Directive = convert(said, Directive)
        check_lane(self.scenario, directive)
        self._episodes.direct(0, directive)

    def render(self) -> NDArray[np.uint8] | None:
        """With `render_mode="rgb_array"`: (height, width, 3) of the road from above, drawn without a screen."""
        return None if self._road is None else self._road.env.render()

    def close(self) -> None:
        if self._road is not None:
            self._road.env.close()

    def _observed(self) -> Observation:
        if self._observed_by is not None:
            seen = np.nan_to_num(self._observed_by.observation_type.observe())  # nan: what an obstacle has none of
            return _image(seen) if self._as_image else seen
        return np.asarray(self._episodes.seen()[0])

    def _info(self) -> dict[str, Any]:
        return one_of(self._episodes.told(), 0)


def _bounded(space: Any, seen: Kinematics | OccupancyGrid) -> Any:
    """highway-env's space of this observation, which is unbounded, with bounds where clipping gives it some."""
    if isinstance(seen, OccupancyGrid) and seen.as_image:
        return gymnasium.spaces.Box(0, 255, space.shape, np.uint8)
    scaled = seen.normalize if isinstance(seen, Kinematics) else True
    if scaled and seen.clip and seen.features_range is None and set(seen.features) <= BOUNDED:
        return gymnasium.spaces.Box(-1.0, 1.0, space.shape, np.float32)
    return space


def _image(seen: Observation) -> NDArray[np.uint8]:
    """-1 to 1 as bytes. highway-env casts its empty cells as nan, which the machine makes what it likes of."""
    return ((np.clip(seen, -1.0, 1.0) + 1.0) * 127.5).astype(np.uint8)
