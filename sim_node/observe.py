"""From the simulated road to the contract's observation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from schemas.wire.messages import ROW_COLUMNS, Observation

if TYPE_CHECKING:
    from sim_node.env import ScenarioEnv

VEHICLES_MAX = 40
"""Besides the ego; keeps a message under 2 KB."""


def rows(env: ScenarioEnv, vehicles_max: int = VEHICLES_MAX) -> NDArray[np.float32]:
    """(V, 9) rows in `ROW_COLUMNS` order: the ego, then at most `vehicles_max` others in sight, the nearest first."""
    ego, sight = env.ego, env.scenario.sight_m
    near: list[tuple[float, int, Any]] = []
    for vehicle in env.road.vehicles:
        distance = float(np.hypot(*(vehicle.position - ego.position)))
        if vehicle is not ego and distance <= sight:
            near.append((distance, vehicle.number, vehicle))
    near.sort(key=lambda item: item[:2])
    seen = [ego, *(vehicle for _, _, vehicle in near[:vehicles_max])]
    table = np.empty((len(seen), len(ROW_COLUMNS)), np.float32)
    for i, v in enumerate(seen):
        (x, y), (vx, vy) = v.position, v.velocity
        table[i] = (v.number, x, y, vx, vy, v.heading, v.LENGTH, v.WIDTH, env.lane_at(float(x), float(y)))
    return table


def perceived(
    table: NDArray[np.float32], rng: Generator, noise_m: float, noise_mps: float, dropout: float
) -> NDArray[np.float32]:
    """The rows as an imperfect sensor reports them: others' positions and speeds off by a normal error, some missing.

    noise_m, noise_mps: standard deviations; dropout: the chance that a car is not seen at this tick. The ego knows
    itself exactly.
    """
    others = table[1:].copy()
    others[:, 1:3] += rng.normal(0.0, noise_m, (len(others), 2)).astype(np.float32)
    others[:, 3:5] += rng.normal(0.0, noise_mps, (len(others), 2)).astype(np.float32)
    seen = rng.random(len(others)) >= dropout
    return np.concatenate([table[:1], others[seen]])


def observe(env: ScenarioEnv, *, epoch: int, tick: int, applied_tick: int, now_ns: int) -> Observation:
    """What the ego sees now, as it is published."""
    ego = env.ego
    return Observation(
        epoch=epoch,
        stamp_ns=now_ns,
        tick=tick,
        scenario=env.scenario.name,
        lanes=env.published_lanes(),
        rows=env.seen().astype("<f4", copy=False).tobytes(),
        acceleration_mps2=float(ego.acceleration),
        target_speed_mps=float(ego.target_speed),
        target_lane=ego.target_lane,
        goal_x_m=env.scenario.end_x_m,
        crashed=bool(ego.crashed),
        applied_tick=applied_tick,
        hz=env.hz,
        previous_lane=ego.previous_lane,
        sight_m=env.scenario.sight_m,
    )
