"""From the simulated road to the contract's observation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.messages import ROW_COLUMNS, Observation

if TYPE_CHECKING:
    from sim_node.env import TwoWayEnv

VEHICLES_MAX = 20
"""Besides the ego; keeps a message under 1.5 KB."""
SIGHT_M = 200.0


def rows(env: TwoWayEnv, vehicles_max: int = VEHICLES_MAX) -> NDArray[np.float32]:
    """(V, 9) rows in `ROW_COLUMNS` order: the ego, then at most `vehicles_max` others in sight, the nearest first."""
    ego = env.ego
    near: list[tuple[float, int, Any]] = []
    for vehicle in env.road.vehicles:
        distance = float(np.hypot(*(vehicle.position - ego.position)))
        if vehicle is not ego and distance <= SIGHT_M:
            near.append((distance, vehicle.number, vehicle))
    near.sort(key=lambda item: item[:2])
    seen = [ego, *(vehicle for _, _, vehicle in near[:vehicles_max])]
    table = np.empty((len(seen), len(ROW_COLUMNS)), np.float32)
    for i, v in enumerate(seen):
        (x, y), (vx, vy) = v.position, v.velocity
        table[i] = (v.number, x, y, vx, vy, v.heading, v.LENGTH, v.WIDTH, env.lane_at(y))
    return table


def observe(env: TwoWayEnv, *, epoch: int, tick: int, applied_tick: int, now_ns: int) -> Observation:
    """What the ego sees now, as it is published."""
    ego = env.ego
    return Observation(
        epoch=epoch,
        stamp_ns=now_ns,
        tick=tick,
        scenario=env.scenario.name,
        lanes=env.lanes,
        rows=rows(env).astype("<f4", copy=False).tobytes(),
        acceleration_mps2=float(ego.acceleration),
        target_speed_mps=float(ego.target_speed),
        target_lane=ego.target_lane,
        goal_x_m=env.scenario.goal_x_m,
        crashed=bool(ego.crashed),
        applied_tick=applied_tick,
        hz=env.hz,
        previous_lane=ego.previous_lane,
    )
