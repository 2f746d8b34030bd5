"""Any `Scenario` as a gymnasium environment on highway-env, driven by our executor at 15 Hz."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import ActionType
from highway_env.envs.common.observation import ObservationType, observation_factory
from highway_env.road.road import Road
from numpy.typing import NDArray

from schemas.driving.episode import Decision, Ending, closeness, ending, flags, held
from schemas.driving.features import BOUND, FEATURES, N_ROWS, features
from schemas.driving.intent import ANY_LANE, Intent
from schemas.driving.road import HZ, X
from schemas.wire.messages import POLICY_ACTIONS, Lane, MetaAction, Observation
from sim_node import actuator, executor
from sim_node.drawing import picture
from sim_node.ego import EgoVehicle
from sim_node.engine.accelerated import Accelerated
from sim_node.engine.kinematics import ArrayKinematics
from sim_node.episode import Wishes, populate
from sim_node.observe import perceived, rows
from sim_node.road import LaneMap, has_left, network
from sim_node.scenario_file import find_scenario
from sim_node.scenarios import Scenario
from sim_node.scenarios.scenario import Spawn, streams

Guard = Callable[["ScenarioEnv", int], int]
"""Called before every tick with the environment and the action; what it returns is done. The safety mask goes here."""


HONOURED = (
    "observation",
    "screen_width",
    "screen_height",
    "centering_position",
    "scaling",
    "show_trajectories",
    "render_agent",
    "offscreen_rendering",
    "real_time_rendering",
)
"""What of highway-env's `config` means something here; the rest are arguments of their own, or of no use."""


_EXECUTED = spaces.Discrete(len(MetaAction))


class _Features(ObservationType):  # type: ignore[misc]
    """The policy's input under the environment's intent, (N_ROWS, F) float32."""

    def space(self) -> spaces.Box:
        return spaces.Box(-BOUND, BOUND, (N_ROWS, len(FEATURES)), np.float32)

    def observe(self) -> NDArray[np.float32]:
        env: ScenarioEnv = self.env
        intent, ego = env.intent, env.ego
        lanes, table = env.published_lanes(), env.seen().tolist()
        own, aim, x = lanes[ego.target_lane], lanes[max(intent.lane, 0)], table[0][X]
        return features(
            table,
            math.nan if intent.lane == ANY_LANE else lanes[intent.lane].y_m,
            intent.speed_mps,
            intent.headway_s,
            ego.target_speed,
            ego.previous_lane >= 0,
            own.end_m - x,
            ego.speed_cap,
            lane=ego.target_lane,
            aim=max(intent.lane, 0),
            opens=own.change_from_m - x,
            aim_ends=aim.end_m - x,
            goal_left=env.scenario.end_x_m - x,
            borrows=min(own.direction, aim.direction) < 0,
        )


class _MetaActions(ActionType):  # type: ignore[misc]
    """`MetaAction` by number; EMERGENCY_BRAKE is executed too, but no policy can sample it."""

    def space(self) -> spaces.Discrete:
        return spaces.Discrete(POLICY_ACTIONS)

    @property
    def vehicle_class(self) -> type[EgoVehicle]:
        return EgoVehicle

    def act(self, action: int) -> None:
        self.env.ego.act(int(action))


class ScenarioEnv(Accelerated, AbstractEnv):  # type: ignore[misc]
    """One scenario: `reset`, `step` one decision, 5-tuple, action mask in `info["action_mask"]`.

    Terminates on a crash; truncates at the road's end, where the place to reach is reached, after `duration_s` (None:
    never): see `schemas.driving.episode`, which training shares. Each episode has a random directive, changed now and
    then, unless one is set with `direct`.
    """

    def __init__(
        self,
        scenario: str | Scenario = "highway",
        *,
        decision_hz: int = HZ,
        hz: int = HZ,
        duration_s: float | str | None = "scenario",
        guard: Guard | None = None,
        checked: bool = False,
        density: float = 1.0,
        traffic: Sequence[str] = (),
        noise_m: float = 0.0,
        noise_mps: float = 0.0,
        dropout: float = 0.0,
        config: dict[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        """`scenario`: a name, a FILE.toml or your own. Raises ValueError for another, and rates that do not divide.

        decision_hz: actions per second, a divisor of hz; hz: simulated ticks per second; guard: see `Guard`;
        density, traffic: see `Scenario.varied`; noise_m, noise_mps, dropout: see `observe.perceived`.
        """
        if isinstance(scenario, str):
            scenario = find_scenario(scenario)
        if decision_hz < 1 or hz % decision_hz:
            # highway-env would floor the quotient and let time drift.
            raise ValueError(f"decision_hz {decision_hz} does not divide {hz} ticks a second: use 1, 3, 5 or {hz}")
        self.scenario = scenario = scenario.varied(traffic, density)
        self.guard, self._checked = guard, checked
        self.refused = (actuator.ADMITTED, -1)
        """Why the actuator did not carry out the last tick's action (`actuator.REASONS`), and for which car."""
        self._rows: NDArray[np.float32] | None = None
        self._seen: NDArray[np.float32] | None = None
        self._imperfect = (noise_m, noise_mps, dropout)
        self._ticks_per_decision = hz // decision_hz
        self._duration_s = scenario.duration_s if isinstance(duration_s, str) else duration_s
        self._seed: int | None = None
        self._gates = scenario.gates().tolist()
        self.lane_map = LaneMap(scenario)
        self._wishes = Wishes(scenario)
        self._rates = {"simulation_frequency": hz, "policy_frequency": hz}
        super().__init__(config or {}, render_mode)

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        config: dict[str, Any] = super().default_config()
        config.update(observation={"type": "Features"}, action={"type": "MetaAction"})
        return config

    @property
    def ego(self) -> EgoVehicle:
        """The controlled car."""
        return self.vehicle

    @property
    def hz(self) -> int:
        """Ticks per second."""
        return int(self.config["simulation_frequency"])

    @property
    def intent(self) -> Intent:
        """What the ego is asked for now."""
        return self._wishes.now

    def lane_at(self, x_m: float, y_m: float) -> int:
        """Index of the lane whose centre line is nearest, among those that exist at `x_m`."""
        return self.lane_map.lane_at(x_m, y_m)

    def published_lanes(self) -> tuple[Lane, ...]:
        """The lanes as they lie beside the ego."""
        return self.lane_map.published(float(self.ego.position[0]))

    def rows(self) -> NDArray[np.float32]:
        """(V, 9) rows of the present tick, the ego first, then the nearest in sight; computed once per tick."""
        if self._rows is None:
            self._rows = rows(self.road, self.ego, self.scenario.sight_m, self.lane_map)
        return self._rows

    def seen(self) -> NDArray[np.float32]:
        """The same rows as the ego's sensors report them."""
        if self._seen is None:
            self._seen = (
                perceived(self.rows(), self._perception, *self._imperfect) if any(self._imperfect) else (self.rows())
            )
        return self._seen

    def configure(self, config: dict[str, Any]) -> None:
        """Only at the start. Raises ValueError for what this environment does not honour."""
        if getattr(self, "observation_space", None) is not None:
            raise ValueError("an environment keeps its config: make another one")
        for name in config:
            if name not in HONOURED:
                raise ValueError(f"config {name!r} is not honoured: choose from {', '.join(HONOURED)}")
        super().configure({**config, **self._rates})

    def define_spaces(self) -> None:
        wanted = self.config["observation"]
        kinds: dict[str, Any] = {"Features": _Features, "Kinematics": ArrayKinematics}
        if (kind := kinds.get(wanted["type"])) is not None:
            self.observation_type = kind(self, **{k: v for k, v in wanted.items() if k != "type"})
        else:
            self.observation_type = observation_factory(self, wanted)
        self.action_type = _MetaActions(self)
        self.observation_space = self.observation_type.space()
        self.action_space = self.action_type.space()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """A new episode: with a seed that very one, without one the next of this environment's own.

        Raises ValueError for options: there are none (`direct` sets a directive).
        """
        if options:
            raise ValueError(f"no option {next(iter(options))!r}: this environment's reset takes none")
        self._seed = seed
        observation: tuple[NDArray[np.float32], dict[str, Any]] = super().reset(seed=seed, options=options)
        return observation

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """One decision: the action at its first tick, then what was done there holds; the guard watches every tick."""
        if not _EXECUTED.contains(action):
            raise ValueError(f"action {action!r} is not one of 0..{POLICY_ACTIONS - 1}, or {POLICY_ACTIONS} to brake")
        ego = self.ego
        decision = Decision(np.array([int(action)]), self.rows()[:1, X], np.array([ego.acceleration]))
        doing = int(action)
        for k in range(self._ticks_per_decision):
            meta = doing if self.guard is None else self.guard(self, doing)
            if k == 0:
                doing = held(meta)
            ego.speed_goal = self.intent.speed_mps
            self.tick(meta)
            table = self.rows().tolist()
            self._wishes.update(table)
            intent, over = self.intent, self.ending()
            ttc, short = closeness(table, ego.target_lane, intent.headway_s)
            decision.tick(
                np.array([meta]),
                self.rows()[:1],
                np.array([ego.acceleration]),
                np.array([ttc]),
                np.array([short]),
                np.array([intent.lane in (ANY_LANE, ego.target_lane)]),
                np.array([int(over)]),
            )
            if over != Ending.NONE:
                break
        worth = float(
            decision.earned(
                np.array([intent.speed_mps]),
                0.5 * self.scenario.ego.speed_ceiling_mps,
                self.hz,
                to_reach=bool(self.scenario.success.reach_lanes),
            )[0]
        )
        terminated, truncated = self._flags()
        if not terminated and not truncated:
            self._wishes.follow(table, ego.target_lane, self._ticks_per_decision / self.hz)
        observation = self.observation_type.observe()
        if self.render_mode == "human":
            self.render()
        return (observation, worth, terminated, truncated, self._info(observation, int(action)))

    def seen_at(self, epoch: int, tick: int, now_ns: int, applied_tick: int) -> Observation:
        """What the ego sees now, as the message of this tick."""
        ego, scenario = self.ego, self.scenario
        return Observation(
            epoch=epoch,
            stamp_ns=now_ns,
            tick=tick,
            scenario=scenario.name,
            lanes=self.published_lanes(),
            rows=self.seen().astype("<f4", copy=False).tobytes(),
            acceleration_mps2=float(ego.acceleration),
            target_speed_mps=float(ego.target_speed),
            target_lane=ego.target_lane,
            goal_x_m=scenario.end_x_m,
            crashed=bool(ego.crashed),
            applied_tick=applied_tick,
            hz=self.hz,
            previous_lane=ego.previous_lane,
            sight_m=scenario.sight_m,
        )

    def update_metadata(self, video_real_time_ratio: float = 1.0) -> None:
        """A picture is one decision long, so a recorded video runs at the speed of the drive."""
        self.metadata["render_fps"] = video_real_time_ratio * self.hz / self._ticks_per_decision

    def render(self) -> NDArray[np.uint8] | None:
        """With `render_mode="rgb_array"`: (height, width, 3) of the road from above, drawn without a screen."""
        if self.render_mode == "rgb_array":
            return picture(self.seen_at(0, self.steps, 0, -1))
        super().render()
        return None

    def tick(self, meta: int) -> None:
        """One tick of the world under one meta-action, without observing it."""
        if self._checked:
            lanes = self.published_lanes()
            ys, ends = [lane.y_m for lane in lanes], [lane.end_m for lane in lanes]
            ego, table = self.ego, self.rows().tolist()
            meta, *why = actuator.check(table, ys, ends, meta, ego.target_lane, ego.previous_lane)
            self.refused = (why[0], why[1])
        self.time += 1 / self.hz
        self._rows = self._seen = None
        self._simulate(meta)
        self.road.vehicles = [v for v in self.road.vehicles if v is self.ego or not has_left(self.scenario, v)]

    def action_masks(self) -> NDArray[np.bool_]:
        """(5,) which actions do anything now: the lane exists here, one change at a time, speed within its bounds."""
        ego, bounds = self.ego, self.scenario.ego
        x, floor, ceiling = float(ego.position[0]), bounds.speed_floor_mps, bounds.speed_ceiling_mps
        out = np.zeros(POLICY_ACTIONS, np.bool_)
        executor.able(self._gates, ego.target_speed, ego.target_lane, ego.previous_lane, x, floor, ceiling, out)
        return out

    def direct(
        self, lane: int = ANY_LANE, speed_mps: float = math.nan, headway_s: float = 1.5, overtake: bool = False
    ) -> None:
        """Set the directive for this and all further episodes, in place of random ones.

        lane: an index or `ANY_LANE`; speed_mps: nan is as fast as the scenario allows; overtake: pass the car ahead,
        through the lane to the left. Raises ValueError for a lane that does not exist.
        """
        self._wishes.direct(self.rows().tolist(), self.ego.target_lane, lane, speed_mps, headway_s, overtake)

    def _reset(self) -> None:
        s = self.scenario
        seed = int(self.np_random.integers(2**31)) if self._seed is None else self._seed
        self._seed = None
        self._rows = self._seen = None
        traffic, wishes, self._perception = streams(seed)
        self.road = Road(
            network=network(s),
            np_random=self.np_random,
            record_history=self.config["show_trajectories"],
            neighbour_vehicles_connected_lanes=s.connected_lanes,
        )
        self.config["neighbour_vehicles_connected_lanes"] = s.connected_lanes
        spawn = s.spawn(traffic)
        self.vehicle = populate(self.road, s, self.lane_map, spawn, 1.0 / self.hz)
        self._populated(seed, spawn)
        self._wishes.begin(wishes, self.rows().tolist(), self.ego.target_lane)

    def _populated(self, seed: int, spawn: Spawn) -> None:
        """The cars of the seed's episode are on the road: for who moves them otherwise."""

    def _info(self, obs: NDArray[np.float32], action: int | None = None) -> dict[str, Any]:
        return {
            "speed": float(self.ego.speed),
            "crashed": bool(self.ego.crashed),
            "action": action,
            "action_mask": self.action_masks().astype(np.int8),
            "intent": self.intent,
        }

    def ending(self) -> Ending:
        """Why the episode is over now, time apart."""
        return Ending(int(ending(np.array([bool(self.ego.crashed)]), self.rows()[:1], self.scenario.goal)[0]))

    def _flags(self) -> tuple[bool, bool]:
        timed_out = self._duration_s is not None and self.steps >= round(self._duration_s * self.hz)
        terminated, truncated = flags(np.array([int(self.ending())]), np.array([timed_out]))
        return bool(terminated[0]), bool(truncated[0])

    def _is_terminated(self) -> bool:
        return self._flags()[0]

    def _is_truncated(self) -> bool:
        return self._flags()[1]
