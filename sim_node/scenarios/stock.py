"""highway-env's own `highway-v0`, `merge-v0` and `two-way-v0` as scenarios: their roads and traffic, our ego.

The cars are those that upstream's environment makes from the scenario's generator, in its order; so their distribution
is upstream's, but a seed is not gymnasium's of the same number. Upstream has no success but not to crash, and no task.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.merge_env import MergeEnv
from highway_env.envs.two_way_env import TwoWayEnv
from numpy.random import Generator

from sim_node.scenarios.manners import draw
from sim_node.scenarios.merge import lanes as merge_lanes
from sim_node.scenarios.scenario import EgoPlan, Expect, LanePlan, Scenario, Spawn, Success, check_density, straight

KINDS: dict[str, type[Any]] = {"highway-v0": HighwayEnv, "merge-v0": MergeEnv, "two-way-v0": TwoWayEnv}


@functools.cache
def _environment(name: str, density: float) -> Any:
    return KINDS[name]({"vehicles_density": density} if name == "highway-v0" else {})


@dataclass(frozen=True, kw_only=True)
class Stock(Scenario):
    """A road of highway-env's whose own environment makes the cars."""

    stock: str
    """Its gymnasium id."""
    cars: int
    """The ego included."""
    vehicles_density: float = 1.0

    def denser(self, factor: float) -> Scenario:
        """`highway-v0` with its `vehicles_density`. Raises ValueError for the others: they have a fixed number of
        cars at fixed places."""
        if self.stock != "highway-v0" and factor != 1.0:
            raise ValueError(f"{self.stock} has no density but 1")
        check_density(factor)
        return dataclasses.replace(self, vehicles_density=self.vehicles_density * factor)

    @property
    def vehicles_max(self) -> int:
        """The most vehicles that `spawn` makes, the ego included."""
        return self.cars

    def spawn(self, rng: Generator) -> Spawn:
        """As upstream's `reset` makes the cars from this generator."""
        env = _environment(self.stock, self.vehicles_density)
        env.np_random = rng
        env._reset()
        cars = env.road.vehicles
        x = np.array([v.position[0] for v in cars], np.float64)
        way = np.array([1 if math.cos(v.heading) > 0 else -1 for v in cars])
        lane = np.array([2 if v.lane_index[0] in ("j", "k") else v.lane_index[2] for v in cars])
        targets = [v.target_speed for v in cars]
        targets[0] = cars[0].speed
        return Spawn(
            x,
            lane,
            way,
            np.array([v.speed for v in cars], np.float64),
            np.array(targets, np.float64),
            np.array([getattr(v, "DELTA", 4.0) for v in cars], np.float64),
            np.array([getattr(v, "timer", 0.0) for v in cars], np.float64),
            np.array([getattr(v, "enable_lane_change", False) for v in cars]),
            draw(self.manners, rng, x, lane),
        )


EGO_MPS = 30.0
ANYTHING = Expect(constant_success_max=1.0, survivable=0.0)
"""Upstream's roads are as they are."""


def _stock(name: str, **fields: Any) -> Stock:
    return Stock(
        name=name,
        description=f"highway-env's {name}",
        stock=name,
        flows=(),
        speed_set="natural",
        expect=ANYTHING,
        **fields,
    )


def _ego(lanes: tuple[int, ...], x_m: float, speed_mps: float) -> EgoPlan:
    return EgoPlan(lanes=lanes, x_m=(x_m, x_m), speed_mps=(speed_mps, speed_mps), speed_ceiling_mps=EGO_MPS)


HIGHWAY = _stock(
    "highway-v0",
    lanes=tuple(LanePlan(pieces=straight(("0", "1"), 10_000.0, 4.0 * k), speed_limit_mps=30.0) for k in range(4)),
    ego=_ego((0, 1, 2, 3), 0.0, 25.0),
    cars=51,
    success=Success(),
    end_x_m=9_000.0,
    wish_lanes=(0, 1, 2, 3),
)

MERGE = _stock(
    "merge-v0",
    lanes=merge_lanes(150.0, 80.0, 80.0, 150.0, 20.0),
    ego=_ego((1,), 30.0, 30.0),
    cars=5,
    success=Success(reach_x_m=370.0, reach_lanes=(0, 1)),
    end_x_m=370.0,
    wish_lanes=(0, 1),
    obstacles=((2, 310.0),),
)

TWO_WAY = _stock(
    "two-way-v0",
    lanes=(
        LanePlan(pieces=straight(("a", "b"), 800.0, 0.0), speed_limit_mps=20.0, direction=-1, kind="oncoming"),
        LanePlan(pieces=straight(("a", "b"), 800.0, 4.0), speed_limit_mps=20.0),
    ),
    ego=_ego((1,), 30.0, 30.0),
    cars=6,
    success=Success(),
    end_x_m=770.0,
)

SCENARIOS = (HIGHWAY, MERGE, TWO_WAY)
