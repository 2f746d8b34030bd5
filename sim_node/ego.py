"""The ego as a vehicle of highway-env, driven by our executor."""

from __future__ import annotations

import math

from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle

from schemas.wire.messages import MetaAction
from sim_node import executor
from sim_node.scenarios import Scenario
from sim_node.scenarios.scenario import centre_line


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
        self.speed_cap = math.inf
        """It drives no faster than this, in m/s, until another is given."""
        self.style = 1
        """0 calm, 1 normal, 2 assertive."""
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
                self.speed_cap,
            )
            return
        speed = float(self.speed)
        y_target, lane_heading = self.lane_ahead()
        self.action = {
            "steering": executor.steering_command(
                float(self.position[1]), float(self.heading), speed, y_target, lane_heading
            ),
            "acceleration": executor.acceleration_command(
                speed, min(self.target_speed, self.speed_cap), self.acceleration, self.meta, self.style, self.dt
            ),
        }

    def lane_ahead(self) -> tuple[float, float]:
        """Where the centre of the target lane is beside the ego (m), and its heading there (rad)."""
        return centre_line(self._lines, self.target_lane, float(self.position[0]))

    def step(self, dt: float) -> None:
        """Move for `dt` s; a lane change that has arrived is over."""
        before = float(self.speed)
        super().step(dt)
        self.arrive(before, dt)

    def arrive(self, before: float, dt: float) -> None:
        """What is known after a tick of `dt` s that began at speed `before` [m/s]."""
        self.acceleration = (float(self.speed) - before) / dt
        if self.previous_lane >= 0 and executor.change_finished(float(self.position[1]), self.lane_ahead()[0]):
            self.previous_lane = -1
