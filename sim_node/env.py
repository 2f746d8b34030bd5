"""Any `Scenario` as a gymnasium environment on highway-env, driven by our executor at 15 Hz."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import ActionType
from highway_env.envs.common.observation import ObservationType
from highway_env.road.lane import LineType, SineLane, StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle
from numpy.typing import NDArray

from schemas.driving.features import BOUND, FEATURES, N_ROWS, features
from schemas.driving.intent import ANY_LANE, Wish, lead_of, wished_lane
from schemas.driving.measures import TTC_CAP_S
from schemas.driving.reward import reward, shortfall
from schemas.wire.messages import POLICY_ACTIONS, Lane, MetaAction
from sim_node import executor
from sim_node.engine import bridge, kernel
from sim_node.engine.accelerated import Accelerated
from sim_node.metrics import CLOSING_MIN_MPS, leader
from sim_node.observe import perceived, rows
from sim_node.scenarios import SCENARIOS, Scenario
from sim_node.scenarios.scenario import Piece, centre_line, draw_wish, streams
from sim_node.traffic import TrafficVehicle

REDIRECT_PER_S = 0.03
"""How often a training episode gets another directive on its way."""

Guard = Callable[["ScenarioEnv", int], int]
"""Called before every tick with the environment and the action; what it returns is done. The safety mask goes here."""


class EgoVehicle(Vehicle):  # type: ignore[misc]
    """A car with the executor's set-points: `act(meta)` edits them once, `act()` steers and accelerates for a tick."""

    def __init__(
        self,
        road: Road,
        scenario: Scenario,
        dt: float,
        lane: int,
        x_m: float,
        y_m: float,
        heading: float,
        speed_mps: float,
    ) -> None:
        super().__init__(road, [x_m, y_m], heading, speed_mps)
        self.number = 0
        self.scenario = scenario
        self.pieces = scenario.pieces()
        self._lines = self.pieces.tolist()
        self.gates = scenario.gates()
        self._gates = self.gates.tolist()
        self.dt = dt
        self.target_speed = speed_mps
        self.target_lane = lane
        self.previous_lane = -1
        self.speed_goal = math.nan
        """A speed step of the coming tick stops here, in m/s; nan: no goal."""
        self.meta = int(MetaAction.CRUISE)
        self.acceleration = 0.0
        """What the last tick did to the speed, in m/s2."""

    def act(self, action: int | None = None) -> None:
        """Edit the set-points by a meta-action, or (without one, as the road calls it) set the controls for a tick."""
        ego = self.scenario.ego
        if action is not None:
            self.meta = int(action)
            self.target_speed, self.target_lane, self.previous_lane = executor.edit_set_points(
                self.meta,
                self.target_speed,
                self.target_lane,
                self.previous_lane,
                self._gates,
                float(self.position[0]),
                self.speed_goal,
                ego.speed_floor_mps,
                ego.speed_ceiling_mps,
            )
            return
        speed = float(self.speed)
        y_target, lane_heading = self.lane_ahead()
        self.action = {
            "steering": executor.steering_command(
                float(self.position[1]), float(self.heading), speed, y_target, lane_heading
            ),
            "acceleration": executor.acceleration_command(
                speed, self.target_speed, self.acceleration, self.meta, self.dt
            ),
        }

    def lane_ahead(self) -> tuple[float, float]:
        """Where the centre of the target lane is beside the ego (m), and its heading there (rad)."""
        return centre_line(self._lines, self.target_lane, float(self.position[0]))

    def step(self, dt: float) -> None:
        """Move for `dt` s; a lane change that has arrived is over."""
        before = float(self.speed)
        super().step(dt)
        self.acceleration = (float(self.speed) - before) / dt
        if self.previous_lane >= 0 and executor.change_finished(float(self.position[1]), self.lane_ahead()[0]):
            self.previous_lane = -1


bridge.KINDS[EgoVehicle] = kernel.EXECUTOR


class _Features(ObservationType):  # type: ignore[misc]
    """The policy's input under the environment's wish, (N_ROWS, F) float32."""

    def space(self) -> spaces.Box:
        return spaces.Box(-BOUND, BOUND, (N_ROWS, len(FEATURES)), np.float32)

    def observe(self) -> NDArray[np.float32]:
        env: ScenarioEnv = self.env
        wish, ego = env.wish, env.ego
        lanes = env.published_lanes()
        return features(
            env.seen().tolist(),
            math.nan if wish.lane == ANY_LANE else lanes[wish.lane].y_m,
            wish.speed_mps,
            wish.headway_s,
            ego.target_speed,
            ego.previous_lane >= 0,
            lanes[ego.target_lane].end_m - float(ego.position[0]),
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

    Terminates on a crash, at the road's end or when the place to reach is reached; truncates after `duration_s`
    (None: never). Each episode has a random directive, changed now and then, unless one is set with `direct`.
    """

    def __init__(
        self,
        scenario: str | Scenario = "highway",
        *,
        decision_hz: int = 15,
        hz: int = 15,
        duration_s: float | str | None = "scenario",
        guard: Guard | None = None,
        density: float = 1.0,
        noise_m: float = 0.0,
        noise_mps: float = 0.0,
        dropout: float = 0.0,
        config: dict[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        """`scenario`: a name or your own; raises ValueError for an unknown name or rates that do not divide.

        decision_hz: actions per second, a divisor of hz; hz: simulated ticks per second; guard: see `Guard`;
        density: times the scenario's own; noise_m, noise_mps, dropout: see `observe.perceived`, in what is observed.
        """
        if isinstance(scenario, str):
            if scenario not in SCENARIOS:
                raise ValueError(f"scenario {scenario!r} is not one of: {', '.join(SCENARIOS)}")
            scenario = SCENARIOS[scenario]
        if decision_hz < 1 or hz % decision_hz:
            # highway-env would floor the quotient and let time drift.
            raise ValueError(f"decision_hz {decision_hz} does not divide {hz} ticks a second: use 1, 3, 5 or {hz}")
        if density != 1.0:
            scenario = scenario.denser(density)
        self.scenario = scenario
        self.guard = guard
        self._rows: NDArray[np.float32] | None = None
        self._seen: NDArray[np.float32] | None = None
        self._imperfect = (noise_m, noise_mps, dropout)
        self._ticks_per_decision = hz // decision_hz
        self._duration_s = scenario.duration_s if isinstance(duration_s, str) else duration_s
        self._seed: int | None = None
        self._pieces = scenario.pieces().tolist()
        self._gates = scenario.gates().tolist()
        self._curved = any(len({p.y_m for p in plan.pieces}) > 1 for plan in scenario.lanes)
        self._lanes = scenario.lanes_at(0.0)
        self._ends = [(plan.pieces[0].start_m, plan.pieces[-1].end_m) for plan in scenario.lanes]
        self.wish = Wish(ANY_LANE, scenario.ego.speed_ceiling_mps, 1.5)
        self._directed = False
        self._told: tuple[int, int, float, float] = (ANY_LANE, -1, 0.0, 1.5)
        rates = {"simulation_frequency": hz, "policy_frequency": hz}
        super().__init__({**(config or {}), **rates}, render_mode)

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

    def lane_at(self, x_m: float, y_m: float) -> int:
        """Index of the lane whose centre line is nearest, among those that exist at `x_m`."""
        best, nearest = 0, math.inf
        for lane, (start, end) in enumerate(self._ends):
            away = abs(centre_line(self._pieces, lane, x_m)[0] - y_m)
            if away < nearest and start <= x_m <= end:
                best, nearest = lane, away
        return best

    def published_lanes(self) -> tuple[Lane, ...]:
        """The lanes as they lie beside the ego."""
        return self.scenario.lanes_at(float(self.ego.position[0])) if self._curved else self._lanes

    def rows(self) -> NDArray[np.float32]:
        """(V, 9) rows of the present tick, the ego first, then the nearest in sight; computed once per tick."""
        if self._rows is None:
            self._rows = rows(self)
        return self._rows

    def seen(self) -> NDArray[np.float32]:
        """The same rows as the ego's sensors report them."""
        if self._seen is None:
            self._seen = (
                perceived(self.rows(), self._perception, *self._imperfect) if any(self._imperfect) else (self.rows())
            )
        return self._seen

    def define_spaces(self) -> None:
        self.observation_type = _Features(self)
        self.action_type = _MetaActions(self)
        self.observation_space = self.observation_type.space()
        self.action_space = self.action_type.space()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """A new episode: with a seed that very one, without one the next of this environment's own."""
        self._seed = seed
        observation: tuple[NDArray[np.float32], dict[str, Any]] = super().reset(seed=seed, options=options)
        return observation

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """One decision: the action at its first tick, then the set-points hold; the guard watches every tick."""
        effort, distance, braked = 0.0, float(self.ego.position[0]), False
        for k in range(self._ticks_per_decision):
            meta = int(action) if k == 0 else int(MetaAction.CRUISE)
            if self.guard is not None:
                meta = self.guard(self, meta)
            braked = braked or meta == MetaAction.EMERGENCY_BRAKE
            self.tick(meta)
            effort += self.ego.acceleration**2
            if self._is_terminated():
                break
        seconds = (k + 1) / self.hz
        earned = self._earned(
            int(action), (float(self.ego.position[0]) - distance) / seconds, effort / (k + 1), braked, seconds
        )
        self._follow()
        observation = self.observation_type.observe()
        if self.render_mode == "human":
            self.render()
        return (observation, earned, self._is_terminated(), self._is_truncated(), self._info(observation, int(action)))

    def tick(self, meta: int) -> None:
        """One tick of the world under one meta-action, without observing it."""
        self.time += 1 / self.hz
        self._rows = self._seen = None
        self._simulate(meta)
        end = self.scenario.road_end_m - kernel.LEFT_ROAD_M
        self.road.vehicles = [
            v
            for v in self.road.vehicles
            if v is self.ego or (v.position[0] < end if math.cos(v.heading) > 0 else v.position[0] > kernel.LEFT_ROAD_M)
        ]

    def action_masks(self) -> NDArray[np.bool_]:
        """(5,) which actions do anything now: the lane exists here, one change at a time, speed within its bounds."""
        ego, scenario = self.ego, self.scenario
        able = np.ones(POLICY_ACTIONS, np.bool_)
        able[MetaAction.SLOW_DOWN] = ego.target_speed > scenario.ego.speed_floor_mps
        able[MetaAction.SPEED_UP] = ego.target_speed < scenario.ego.speed_ceiling_mps
        for action, step in ((MetaAction.LEFT, -1), (MetaAction.RIGHT, 1)):
            aim = ego.target_lane + step
            if ego.previous_lane >= 0:
                able[action] = aim == ego.previous_lane
            else:
                able[action] = executor.lane_beside(self._gates, ego.target_lane, aim, float(ego.position[0]))
        return able

    def direct(
        self, lane: int = ANY_LANE, speed_mps: float = math.nan, headway_s: float = 1.5, overtake: bool = False
    ) -> None:
        """Set the directive for this and all further episodes, in place of random ones.

        lane: an index or `ANY_LANE`; speed_mps: nan is as fast as the scenario allows; overtake: pass the car ahead,
        through the lane to the left. Raises ValueError for a lane that does not exist.
        """
        if lane != ANY_LANE and not 0 <= lane < len(self.scenario.lanes):
            raise ValueError(f"lane {lane} is not one of 0..{len(self.scenario.lanes) - 1}")
        speed = self.scenario.ego.speed_ceiling_mps if math.isnan(speed_mps) else speed_mps
        home = self.ego.target_lane
        passed = lead_of(self.rows().tolist(), home) if overtake else -1
        self._directed = True
        self._told = (home if overtake else lane, passed, speed, headway_s)
        self._update_wish()

    def _follow(self) -> None:
        if not self._directed and self._wishes.random() < REDIRECT_PER_S * self._ticks_per_decision / self.hz:
            self._draw()
        self._update_wish()

    def _draw(self) -> None:
        self._told = draw_wish(self._wishes, self.scenario, self.rows().tolist(), self.ego.target_lane)

    def _update_wish(self) -> None:
        lane, passed, speed, headway = self._told
        if passed >= 0:
            lane = wished_lane(self.rows().tolist(), lane, passed)
        self.wish = Wish(lane, speed, headway)

    def _reset(self) -> None:
        s = self.scenario
        seed = int(self.np_random.integers(2**31)) if self._seed is None else self._seed
        self._seed = None
        self._rows = self._seen = None
        traffic, self._wishes, self._perception = streams(seed)
        self.road = Road(
            network=network(s),
            np_random=self.np_random,
            record_history=self.config["show_trajectories"],
            neighbour_vehicles_connected_lanes=s.connected_lanes,
        )
        self.config["neighbour_vehicles_connected_lanes"] = s.connected_lanes
        for lane, x in s.obstacles:
            self.road.objects.append(Obstacle(self.road, [x, centre_line(self._pieces, lane, x)[0]]))
        drawn = s.spawn(traffic)
        for i in range(len(drawn.x)):
            lane, x, speed = int(drawn.lane[i]), float(drawn.x[i]), float(drawn.speed[i])
            y, heading = centre_line(self._pieces, lane, x)
            if i == 0:
                self.vehicle = EgoVehicle(self.road, s, 1.0 / self.hz, lane, x, y, heading, speed)
                self.road.vehicles.append(self.vehicle)
                continue
            vehicle = TrafficVehicle(
                self.road,
                [x, y],
                heading=heading if drawn.direction[i] > 0 else heading + math.pi,
                speed=speed,
                target_lane_index=lane_index(s, lane, x),
                target_speed=float(drawn.target_speed[i]),
                enable_lane_change=bool(drawn.lane_changes[i]),
                timer=float(drawn.timer[i]),
            )
            vehicle.DELTA = float(drawn.delta[i])
            vehicle.number = i
            self.road.vehicles.append(vehicle)
        if not self._directed:
            self._draw()
        self._update_wish()

    def _earned(self, action: int, speed: float, accel_square: float, braked: bool, seconds: float) -> float:
        one = np.asarray
        gap, closing = leader(self.rows()[None], np.array([self.ego.target_lane]))
        ttc = float(gap[0] / closing[0]) if closing[0] > CLOSING_MIN_MPS else TTC_CAP_S
        short = shortfall(float(gap[0]), speed, self.wish.headway_s) if np.isfinite(gap[0]) else 0.0
        lane = self.wish.lane
        return float(
            reward(
                one(speed),
                one(self.wish.speed_mps),
                0.5 * self.scenario.ego.speed_ceiling_mps,
                one(accel_square),
                one(action != MetaAction.CRUISE),
                one(lane in (ANY_LANE, self.ego.target_lane)),
                one(ttc),
                one(short),
                one(braked),
                one(self.ego.crashed),
                seconds,
            )
        )

    def _info(self, obs: NDArray[np.float32], action: int | None = None) -> dict[str, Any]:
        return {
            "speed": float(self.ego.speed),
            "crashed": bool(self.ego.crashed),
            "action": action,
            "action_mask": self.action_masks(),
            "wish": self.wish,
        }

    def reached(self) -> bool:
        """Whether the ego is past the place that the scenario wants reached, in a lane that counts."""
        goal = self.scenario.success
        x, y = self.ego.position
        return bool(goal.reach_lanes) and x > goal.reach_x_m and self.lane_at(float(x), float(y)) in goal.reach_lanes

    def _is_terminated(self) -> bool:
        return bool(self.ego.crashed or self.ego.position[0] > self.scenario.end_x_m or self.reached())

    def _is_truncated(self) -> bool:
        return self._duration_s is not None and self.steps >= round(self._duration_s * self.hz)


def network(scenario: Scenario) -> RoadNetwork:
    """The scenario's lanes as highway-env's graph; an oncoming lane is on the map in both directions."""
    solid, striped, none = LineType.CONTINUOUS_LINE, LineType.STRIPED, LineType.NONE
    net = RoadNetwork()
    last = len(scenario.lanes) - 1
    for k, plan in enumerate(scenario.lanes):
        limit, width = plan.speed_limit_mps, plan.width_m
        for piece in plan.pieces:
            alone = not any(p.edge == piece.edge for j, o in enumerate(scenario.lanes) for p in o.pieces if j != k)
            lines = (solid if k == 0 or alone else striped, solid if k == last or alone else none)
            forbidden = plan.kind == "ramp" or piece.end_m <= plan.change_from_m
            ends = [piece.start_m, piece.y_m], [piece.end_m, piece.y_m]
            if piece.amplitude_m:
                lane = SineLane(*ends, piece.amplitude_m, piece.pulsation, piece.phase, width, lines, forbidden, limit)
            else:
                lane = StraightLane(*ends, width, lines, forbidden, limit)
            net.add_lane(*piece.edge, lane)
            if plan.direction < 0:
                back = StraightLane(ends[1], ends[0], width, (none, none), forbidden, limit)
                net.add_lane(piece.edge[1], piece.edge[0], back)
    return net


def lane_index(scenario: Scenario, lane: int, x_m: float) -> tuple[str, str, int]:
    """highway-env's index of the piece of `lane` at `x_m`."""
    plan = scenario.lanes[lane]
    piece: Piece = next((p for p in reversed(plan.pieces) if x_m >= p.start_m), plan.pieces[0])
    if plan.direction < 0:
        edge = (piece.edge[1], piece.edge[0])
        same = [k for k, o in enumerate(scenario.lanes) if o.direction < 0]
    else:
        edge = piece.edge
        same = [k for k, o in enumerate(scenario.lanes) if any(p.edge == piece.edge for p in o.pieces)]
    return (*edge, same.index(lane))
