"""A scenario whose other cars are driven by SUMO: the same environment, another traffic."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.vehicle.kinematics import Vehicle

from sim_node.env import ScenarioEnv
from sim_node.scenarios.scenario import Spawn
from sim_node.sumo.traffic import Traffic

_YES = np.ones(1, np.bool_)


class SumoEnv(ScenarioEnv):
    """`ScenarioEnv` in SUMO's traffic. Raises `ConfigError` where SUMO is not installed.

    A seed has the road, the ego and the cars of `ScenarioEnv` at the start; then each drives as its SUMO driver does.
    The ego moves by our executor, as there, and SUMO is told where it is; what touches is judged as there, too.
    """

    _traffic: Traffic | None = None

    def _populated(self, seed: int, spawn: Spawn) -> None:
        if self._traffic is None:
            self._traffic = Traffic(self.scenario, self.hz)
        self._traffic.load([spawn], seed)
        self._cars: dict[int, Vehicle] = {v.number: v for v in self.road.vehicles if v is not self.ego}
        self._take_in()

    def _simulate(self, action: Any = None) -> None:
        ego, traffic = self.ego, self._traffic
        assert traffic is not None
        if action is not None:
            self.action_type.act(action)
        ego.act()
        ego.step(1.0 / self.hz)
        traffic.tick(ego.position[:1], ego.position[1:], np.array([ego.heading]), _YES)
        self._take_in()
        others = [*self.road.vehicles[1:], *self.road.objects]
        ego.crashed = ego.crashed or any(ego._is_colliding(other, 0.0)[0] for other in others)
        self.steps += 1
        self.enable_auto_render = False

    def _take_in(self) -> None:
        """Put every other car where SUMO has it."""
        traffic = self._traffic
        assert traffic is not None
        self.road.vehicles = [self.ego]
        for i, car in self._cars.items():
            if traffic.here[0, i]:
                car.position = np.array([traffic.x[0, i], traffic.y[0, i]])
                car.heading, car.speed = float(traffic.heading[0, i]), float(traffic.speed[0, i])
                self.road.vehicles.append(car)

    def close(self) -> None:
        """End SUMO's world, and the environment."""
        if self._traffic is not None:
            self._traffic.close()
            self._traffic = None
        super().close()
