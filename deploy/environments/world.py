"""Worlds whose episodes have seeds: many scenes in the batched engine, or one road of highway-env's objects with one
ego or several. Both are what `fast_node.training.rollout` asks of a `World`.

Axes: S scenes (on one road: its egos), V vehicles, L lanes.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fast_node.training.rollout import World
from schemas.driving.measures import CAR_LENGTH_M
from schemas.driving.road import DT_S, ID, NOBODY, VX, VY, X
from schemas.wire.messages import ROW_COLUMNS
from sim_node.ego import EgoVehicle
from sim_node.engine.batched import Batched
from sim_node.engine.kernel.layout import ABSENT_X_M
from sim_node.env import ScenarioEnv
from sim_node.scenarios import Scenario
from sim_node.scenarios.scenario import streams

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


class SeededWorld(World, Protocol):
    """A world that begins an episode by its seed."""

    def begin(self, which: Bools, seeds: Ints) -> None:
        """Start the episodes `seeds` (S,) in the scenes `which` (S,)."""


class BatchedWorld(Batched):
    """Many scenes at once."""

    def begin(self, which: Bools, seeds: Ints) -> None:
        """Start the episodes `seeds` (S,) in the scenes `which` (S,)."""
        for scene in np.flatnonzero(which):
            self.load(int(scene), self.scenario.spawn(streams(int(seeds[scene]))[0]))


class RoadWorld:
    """One road. Its scenes are its egos: each sees the same cars, itself first.

    The compiled kernel ticks it. Its set-points are the first ego's; the others bring their controls along.
    """

    def __init__(self, env: ScenarioEnv, egos: int = 1) -> None:
        """env: reset by `begin`."""
        self.env, self.scenario = env, env.scenario
        lanes, vehicles = len(self.scenario.lanes), self.scenario.vehicles_max
        self.rows = np.zeros((egos, vehicles, len(ROW_COLUMNS)), np.float32)
        self.lane_y, self.target_speed, self.accel = np.zeros((egos, lanes)), np.zeros(egos), np.zeros(egos)
        self.target_lane, self.previous_lane = np.zeros(egos, np.int64), np.full(egos, -1)
        self.ticks, self.crashed = np.zeros(egos, np.int64), np.zeros(egos, np.bool_)
        self.egos: list[EgoVehicle] = []
        self._away = np.zeros(egos, np.bool_)

    def begin(self, which: Bools, seeds: Ints) -> None:
        """Start the episode seeds[0], for all egos. Raises ValueError where there are fewer cars than egos."""
        self.env.reset(seed=int(seeds[0]))
        self.egos = [self.env.ego, *self._taken_over(len(self.ticks) - 1)]
        self.ticks[:], self._away[:], self.rows[:] = 0, False, 0.0
        self._read()

    def tick(self, meta: Ints, speed_goal: Floats, speed_cap: Floats, style: Ints) -> None:
        """Advance the road by 1/15 s: one `MetaAction` (S,) per ego, its speed goal and cap (S,) and its style (S,).

        A lone ego that has crashed stands still, its tick too, as in `Batched`.
        """
        alone = len(self.egos) == 1
        if alone and self.egos[0].crashed:
            return
        before = [float(ego.speed) for ego in self.egos]
        for k, ego in enumerate(self.egos):
            ego.speed_goal, ego.speed_cap, ego.style = float(speed_goal[k]), float(speed_cap[k]), int(style[k])
            if k:
                ego.act(int(meta[k]))
                ego.act()
        self.env.tick(int(meta[0]))
        for k, ego in enumerate(self.egos):
            if k and not self._away[k]:
                ego.arrive(before[k], DT_S)
        self.ticks += 1
        self._read()

    def take_away(self, which: Bools) -> None:
        """These egos (S,) leave the road; what is known of them stays as it is."""
        for k in np.flatnonzero(which & ~self._away):
            self._away[k] = True
            self.env.road.vehicles = [v for v in self.env.road.vehicles if v is not self.egos[k]]

    def reset(self, mask: Bools) -> None:
        """Nothing: see `begin`."""

    def copy(self, other: Any, scenes: Ints) -> None:
        """Not possible: a teacher needs the batched engine."""
        raise NotImplementedError("a road of objects cannot be copied: use BatchedWorld")

    def _taken_over(self, egos: int) -> list[EgoVehicle]:
        """The cars nearest to the first ego, in its direction, become egos."""
        road, first, ours = self.env.road, self.env.ego, []
        able = [
            v
            for v in road.vehicles
            if v is not first and np.cos(v.heading) > 0 and v.LENGTH == CAR_LENGTH_M and len(v.position)
        ]
        if len(able) < egos:
            raise ValueError(f"{egos + 1} egos on a road with {len(able) + 1} cars: choose fewer, or a denser road")
        able.sort(key=lambda v: (abs(v.position[0] - first.position[0]), v.number))
        for car in able[:egos]:
            x, y = (float(value) for value in car.position)
            lane = self.env.lane_at(x, y)
            ego = EgoVehicle(road, self.scenario, DT_S, lane, x, y, float(car.heading), float(car.speed))
            ego.number = car.number
            road.vehicles[road.vehicles.index(car)] = ego
            ours.append(ego)
        return ours

    def _read(self) -> None:
        """What the egos are and see now, vehicles in the order of their numbers but for the ego, which is first."""
        env, cars = self.env, self.env.road.vehicles
        places = np.array([v.position for v in cars])
        numbers = np.array([v.number for v in cars])
        table = np.zeros((len(cars), len(ROW_COLUMNS)), np.float32)
        for i, v in enumerate(cars):
            (x, y), (vx, vy) = v.position, v.velocity
            table[i] = (v.number, x, y, vx, vy, v.heading, v.LENGTH, v.WIDTH, env.lane_at(float(x), float(y)))
        for k, ego in enumerate(self.egos):
            self.target_speed[k], self.target_lane[k], self.previous_lane[k] = (
                ego.target_speed,
                ego.target_lane,
                ego.previous_lane,
            )
            self.accel[k], self.crashed[k] = ego.acceleration, bool(ego.crashed)
            self.lane_y[k] = [
                env.lane_map.centre(lane, float(ego.position[0]))[0] for lane in range(len(self.lane_y[k]))
            ]
            if self._away[k]:
                continue
            at = np.where(numbers == ego.number, 0, np.where(numbers == 0, ego.number, numbers))
            near = np.hypot(*(places - ego.position).T) <= self.scenario.sight_m
            rows = self.rows[k]
            rows[:, ID], rows[:, X], rows[:, [VX, VY]] = NOBODY, ABSENT_X_M, 0.0
            rows[at[near]] = table[near]
            rows[at[near], ID] = at[near]


def one_road(scenario: Scenario, observation: dict[str, Any], render_mode: str | None, hz: int) -> RoadWorld:
    """One road with one ego, which highway-env's own observations and pictures can be made of. hz: of decisions."""
    seen = {"observation": observation}
    return RoadWorld(ScenarioEnv(scenario, decision_hz=hz, duration_s=None, config=seen, render_mode=render_mode))
