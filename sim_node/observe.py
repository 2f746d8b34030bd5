"""What the ego sees: the rows of the vehicles in sight, as they are and as a sensor reports them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from highway_env.road.road import Road
from numpy.random import Generator
from numpy.typing import NDArray

from schemas.driving.road import ID, NOBODY, VX, VY, X, Y
from schemas.wire.messages import ROW_COLUMNS
from sim_node.ego import EgoVehicle
from sim_node.road import LaneMap
from sim_node.scenarios.scenario import streams

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


class Senses:
    """The same sensor in many scenes at once, each with its own errors: those of `perceived` for that seed."""

    def __init__(self, seeds: Sequence[int], noise_m: float, noise_mps: float, dropout: float) -> None:
        """seeds: of the scenes' episodes."""
        self._rngs = [streams(seed)[2] for seed in seeds]
        self._imperfect = (noise_m, noise_mps, dropout)

    def begin(self, scene: int, seed: int) -> None:
        """Another episode begins in a scene."""
        self._rngs[scene] = streams(seed)[2]

    def __call__(self, scene: int, table: NDArray[np.float32]) -> NDArray[np.float32]:
        """(V, 9) rows of a scene, ID negative where nobody is: the same rows as its ego perceives them."""
        here = np.flatnonzero(table[:, ID] >= 0)
        away = np.hypot(table[here, X] - table[0, X], table[here, Y] - table[0, Y])
        nearest = here[np.lexsort((table[here, ID], away))]  # in the order of a message: each car has the error that
        seen = perceived(table[nearest], self._rngs[scene], *self._imperfect)  # it has there
        out = np.zeros_like(table)
        out[:, ID] = NOBODY
        out[: len(seen)] = seen
        return out


def senses(seeds: Sequence[int], noise_m: float, noise_mps: float, dropout: float) -> Senses | None:
    """The sensor of these episodes; None where it misses and mistakes nothing."""
    return Senses(seeds, noise_m, noise_mps, dropout) if noise_m or noise_mps or dropout else None
