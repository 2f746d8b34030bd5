"""What the ego sees: the rows of the vehicles in sight, as they are and as a sensor reports them."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.road import Road
from numpy.random import Generator
from numpy.typing import NDArray

from schemas.driving.road import VX, VY, X, Y
from schemas.wire.messages import ROW_COLUMNS
from sim_node.ego import EgoVehicle
from sim_node.road import LaneMap

VEHICLES_MAX = 40
"""Besides the ego; keeps a message under 2 KB."""


def rows(
    road: Road, ego: EgoVehicle, sight_m: float, lanes: LaneMap, vehicles_max: int = VEHICLES_MAX
) -> NDArray[np.float32]:
    """(V, 9) rows in `ROW_COLUMNS` order: the ego, then at most `vehicles_max` others in sight, the nearest first."""
    near: list[tuple[float, int, Any]] = []
    for vehicle in road.vehicles:
        distance = float(np.hypot(*(vehicle.position - ego.position)))
        if vehicle is not ego and distance <= sight_m:
            near.append((distance, vehicle.number, vehicle))
    near.sort(key=lambda item: item[:2])
    seen = [ego, *(vehicle for _, _, vehicle in near[:vehicles_max])]
    table = np.empty((len(seen), len(ROW_COLUMNS)), np.float32)
    for i, v in enumerate(seen):
        (x, y), (vx, vy) = v.position, v.velocity
        table[i] = (v.number, x, y, vx, vy, v.heading, v.LENGTH, v.WIDTH, lanes.lane_at(float(x), float(y)))
    return table


def perceived(
    table: NDArray[np.float32], rng: Generator, noise_m: float, noise_mps: float, dropout: float
) -> NDArray[np.float32]:
    """The rows as an imperfect sensor reports them: others' positions and speeds off by a normal error, some missing.

    noise_m, noise_mps: standard deviations; dropout: the chance that a car is not seen at this tick. The ego knows
    itself exactly.
    """
    others = table[1:].copy()
    others[:, [X, Y]] += rng.normal(0.0, noise_m, (len(others), 2)).astype(np.float32)
    others[:, [VX, VY]] += rng.normal(0.0, noise_mps, (len(others), 2)).astype(np.float32)
    seen = rng.random(len(others)) >= dropout
    return np.concatenate([table[:1], others[seen]])
