"""An episode on highway-env's objects: who is on the road, and what is wished."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.objects import Obstacle
from numpy.random import Generator

from schemas.driving.episode import REDIRECT_PER_S
from schemas.driving.intent import ANY_LANE, Intent, intended_lane
from schemas.driving.road import NOBODY, lead_id
from sim_node.ego import EgoVehicle
from sim_node.road import LaneMap, lane_index
from sim_node.scenarios import Scenario
from sim_node.scenarios.scenario import Spawn, draw_wish
from sim_node.traffic import TrafficVehicle


def populate(road: Road, scenario: Scenario, lanes: LaneMap, spawn: Spawn, dt: float) -> EgoVehicle:
    """Put the scenario's obstacles and the drawn vehicles on an empty road; the ego is the first. dt: of a tick [s]."""
    for lane, x in scenario.obstacles:
        road.objects.append(Obstacle(road, [x, lanes.centre(lane, x)[0]]))
    for i in range(len(spawn.x)):
        lane, x, speed = int(spawn.lane[i]), float(spawn.x[i]), float(spawn.speed[i])
        y, heading = lanes.centre(lane, x)
        if i == 0:
            ego = EgoVehicle(road, scenario, dt, lane, x, y, heading, speed)
            road.vehicles.append(ego)
            continue
        vehicle = TrafficVehicle(
            road,
            [x, y],
            heading=heading if spawn.direction[i] > 0 else heading + math.pi,
            speed=speed,
            target_lane_index=lane_index(scenario, lane, x),
            target_speed=float(spawn.target_speed[i]),
            enable_lane_change=bool(spawn.lane_changes[i]),
            timer=float(spawn.timer[i]),
        )
        vehicle.DELTA = float(spawn.delta[i])
        vehicle.behave(spawn.manners[i])
        vehicle.number = i
        road.vehicles.append(vehicle)
    return ego


class Wishes:
    """What the ego is asked for: random directives, drawn now and then, unless one is set with `direct`."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._fixed = False
        self._told: tuple[int, int, float, float] = (ANY_LANE, NOBODY, 0.0, 1.5)
        self._rng = np.random.default_rng(0)
        self.now = Intent(ANY_LANE, scenario.ego.speed_ceiling_mps, 1.5)

    def begin(self, rng: Generator, rows: Any, lane: int) -> None:
        """A new episode, whose directives come from `rng`. rows (V, 9); lane: the ego's."""
        self._rng = rng
        if not self._fixed:
            self._told = draw_wish(self._scenario, rng, rows, lane)
        self.update(rows)

    def direct(self, rows: Any, home: int, lane: int, speed_mps: float, headway_s: float, overtake: bool) -> None:
        """Set the directive for good: see `ScenarioEnv.direct`."""
        if lane != ANY_LANE and not 0 <= lane < len(self._scenario.lanes):
            raise ValueError(f"lane {lane} is not one of 0..{len(self._scenario.lanes) - 1}")
        speed = self._scenario.ego.speed_ceiling_mps if math.isnan(speed_mps) else speed_mps
        self._fixed = True
        self._told = (home, lead_id(rows, home), speed, headway_s) if overtake else (lane, NOBODY, speed, headway_s)
        self.update(rows)

    def follow(self, rows: Any, lane: int, seconds: float) -> None:
        """After a decision of `seconds` that was not the last: perhaps another directive."""
        if not self._fixed and self._rng.random() < REDIRECT_PER_S * seconds:
            self._told = draw_wish(self._scenario, self._rng, rows, lane)
            self.update(rows)

    def update(self, rows: Any) -> None:
        """At every tick: the wish that the directive comes down to now."""
        lane, passed, speed, headway = self._told
        if passed >= 0:
            lane = intended_lane(rows, lane, passed)
        self.now = Intent(lane, speed, headway)
