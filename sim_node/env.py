"""The two-way scenario as a highway-env environment, driven by our executor at 15 Hz."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import ActionType
from highway_env.envs.common.observation import ObservationType
from highway_env.road.lane import LineType, StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from schemas.messages import ROW_COLUMNS, MetaAction
from sim_node import executor
from sim_node.observe import rows
from sim_node.scenarios import SCENARIOS, Scenario

ROWS_N = 15
"""Rows of the gymnasium observation: padded with zeros, or the farthest left out."""
LEFT_ROAD_M = 20.0
"""Other cars vanish this near to the road's ends: upstream would have them turn round."""


class EgoVehicle(Vehicle):  # type: ignore[misc]
    """A car with the executor's set-points: `act(meta)` edits them once, `act()` steers and accelerates for a tick."""

    def __init__(self, road: Road, scenario: Scenario, dt: float, x_m: float, speed_mps: float) -> None:
        super().__init__(road, [x_m, scenario.lane_y_m[scenario.ego_lane]], 0.0, speed_mps)
        self.number = 0
        self.scenario = scenario
        self.dt = dt
        self.target_speed = speed_mps
        self.target_lane = scenario.ego_lane
        self.previous_lane = -1
        self.speed_goal = math.nan
        """A speed step of the coming tick stops here, in m/s; nan: no goal."""
        self.meta = int(MetaAction.CRUISE)
        self.acceleration = 0.0
        """What the last tick did to the speed, in m/s2."""

    def act(self, action: int | None = None) -> None:
        """Edit the set-points by a meta-action, or (without one, as the road calls it) set the controls for a tick."""
        s = self.scenario
        if action is not None:
            self.meta = int(action)
            self.target_speed, self.target_lane, self.previous_lane = executor.edit_set_points(
                self.meta,
                self.target_speed,
                self.target_lane,
                self.previous_lane,
                len(s.lane_y_m),
                self.speed_goal,
                s.speed_floor_mps,
                s.speed_ceiling_mps,
            )
            return
        x, y = float(self.position[0]), float(self.position[1])
        speed = float(self.speed)
        y_target = s.lane_y_m[self.target_lane]
        self.action = {
            "steering": executor.steering_command(x, y, float(self.heading), speed, y_target),
            "acceleration": executor.acceleration_command(
                speed, self.target_speed, self.acceleration, self.meta, self.dt
            ),
        }

    def step(self, dt: float) -> None:
        """Move for `dt` s; a lane change that has arrived is over."""
        before = float(self.speed)
        super().step(dt)
        self.acceleration = (float(self.speed) - before) / dt
        y_target = self.scenario.lane_y_m[self.target_lane]
        if self.previous_lane >= 0 and executor.change_finished(float(self.position[1]), y_target):
            self.previous_lane = -1


class _Rows(ObservationType):  # type: ignore[misc]
    """The contract's rows as a box, without the pandas frame that upstream builds at every step."""

    def space(self) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, (ROWS_N, len(ROW_COLUMNS)), np.float32)

    def observe(self) -> NDArray[np.float32]:
        table = np.zeros((ROWS_N, len(ROW_COLUMNS)), np.float32)
        seen = rows(self.env, ROWS_N - 1)
        table[: len(seen)] = seen
        return table


class _MetaActions(ActionType):  # type: ignore[misc]
    """`MetaAction` by number."""

    def space(self) -> spaces.Discrete:
        return spaces.Discrete(len(MetaAction))

    @property
    def vehicle_class(self) -> type[EgoVehicle]:
        return EgoVehicle

    def act(self, action: int) -> None:
        self.env.ego.act(int(action))


class TwoWayEnv(AbstractEnv):  # type: ignore[misc]
    """1 + 1 lanes, slow leads, oncoming traffic (which does not brake for the ego: upstream's behaviour).

    Terminates on a crash or near the road's end. Truncates only with `config["duration_s"]` set; time is the runtime's.
    """

    scenario: Scenario = SCENARIOS["two-way"]

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        config: dict[str, Any] = super().default_config()
        config.update(
            observation={"type": "Rows"},
            action={"type": "MetaAction"},
            simulation_frequency=15,
            policy_frequency=15,
            duration_s=None,
        )
        return config

    @property
    def ego(self) -> EgoVehicle:
        """The controlled car."""
        return self.vehicle

    @property
    def hz(self) -> int:
        """Ticks per second."""
        return int(self.config["simulation_frequency"])

    def lane_at(self, y_m: float) -> int:
        """Index of the lane whose centre line is nearest."""
        centres = self.scenario.lane_y_m
        return min(range(len(centres)), key=lambda i: abs(centres[i] - y_m))

    def define_spaces(self) -> None:
        self.observation_type = _Rows(self)
        self.action_type = _MetaActions(self)
        self.observation_space = self.observation_type.space()
        self.action_space = self.action_type.space()

    def _reset(self) -> None:
        s = self.scenario
        self.lanes = s.lanes()
        left, own = s.lane_y_m
        length, limit = s.road_length_m, s.speed_limit_mps
        none, solid, striped = LineType.NONE, LineType.CONTINUOUS_LINE, LineType.STRIPED
        net = RoadNetwork()
        # The oncoming lane is on the map in both directions, so that cars which borrow it have a lane to be in.
        net.add_lane("a", "b", StraightLane([0, left], [length, left], s.lane_width_m, (solid, striped), False, limit))
        net.add_lane("a", "b", StraightLane([0, own], [length, own], s.lane_width_m, (none, solid), False, limit))
        net.add_lane("b", "a", StraightLane([length, left], [0, left], s.lane_width_m, (none, none), False, limit))
        self.road = Road(network=net, np_random=self.np_random, record_history=self.config["show_trajectories"])
        drawn = s.spawn(self.np_random)
        self.vehicle = EgoVehicle(self.road, s, 1.0 / self.hz, float(drawn.x[0]), float(drawn.speed[0]))
        self.road.vehicles.append(self.vehicle)
        for i in range(1, len(drawn.x)):
            ahead = drawn.direction[i] > 0
            lane = int(drawn.lane[i])
            vehicle = IDMVehicle(
                self.road,
                [float(drawn.x[i]), s.lane_y_m[lane]],
                heading=0.0 if ahead else math.pi,
                speed=float(drawn.speed[i]),
                target_lane_index=("a", "b", lane) if ahead else ("b", "a", 0),
                target_speed=float(drawn.target_speed[i]),
                enable_lane_change=False,
            )
            vehicle.DELTA = float(drawn.delta[i])
            vehicle.number = i
            self.road.vehicles.append(vehicle)

    def _simulate(self, action: int | None = None) -> None:
        super()._simulate(action)
        first, last = LEFT_ROAD_M, self.scenario.road_length_m - LEFT_ROAD_M
        self.road.vehicles = [v for v in self.road.vehicles if v is self.ego or first < v.position[0] < last]

    def _reward(self, action: int) -> float:
        return -1.0 if self.ego.crashed else float(self.ego.speed) / self.scenario.speed_ceiling_mps

    def _is_terminated(self) -> bool:
        return bool(self.ego.crashed or self.ego.position[0] > self.scenario.goal_x_m)

    def _is_truncated(self) -> bool:
        duration_s = self.config["duration_s"]
        return duration_s is not None and self.steps >= round(duration_s * self.hz)
