"""How the other cars may differ from highway-env's: drivers, trucks, sudden braking, narrow lanes, sway.

A `Manners` is part of a scenario; what it draws comes from the traffic's own generator, after everything else, so that
a road without it keeps its episodes. `VARIED` has some by name. SI units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from schemas.driving.measures import CAR_LENGTH_M

Range = tuple[float, float]

IDM_ACCEL, IDM_BRAKE, IDM_GAP, IDM_TIME, CAR_LENGTH, HARD_FROM, HARD_TO, HARD_MPS2, SWAY_M, SWAY_RATE, SWAY_PHASE = (
    range(11)
)
"""Columns of `Spawn.manners`. IDM_GAP: centre to centre, at rest. HARD_FROM, HARD_TO: seconds between which a car
brakes with HARD_MPS2, whatever is ahead. SWAY: it keeps SWAY_M * sin(SWAY_RATE * t + SWAY_PHASE) [m] beside its lane's
centre."""
PLAIN = (3.0, 5.0, 10.0, 1.5, CAR_LENGTH_M, -1.0, -1.0, 0.0, 0.0, 0.0, 0.0)
"""A car as highway-env has it."""
START_GAP_M = 8.0
"""A truck that would leave less than this to a car in its lane when the scene begins is a car instead."""


@dataclass(frozen=True, kw_only=True)
class Manners:
    """What is drawn for each car of an episode. Ranges are (low, high) of a uniform draw."""

    idm_spread: float = 0.0
    """Each of a car's four IDM constants is multiplied by 1 - this to 1 + this."""
    hard_brakers: float = 0.0
    """Share of the cars that start ahead of the ego that brake hard once."""
    hard_mps2: Range = (6.0, 9.0)
    hard_s: Range = (1.0, 3.0)
    """For how long."""
    hard_at_s: Range = (2.0, 30.0)
    """When."""
    trucks: float = 0.0
    """Share of the cars that are trucks."""
    truck_m: Range = (12.0, 16.5)
    sway_m: float = 0.0
    """How far the cars sway to either side."""
    sway_s: Range = (4.0, 8.0)
    """For how long there and back."""

    @property
    def plain(self) -> bool:
        """Whether every car is highway-env's."""
        return not (self.idm_spread or self.hard_brakers or self.trucks or self.sway_m)


USUAL = Manners()
"""Those of highway-env."""
VARIED: dict[str, dict[str, Any]] = {
    "idm30": {"idm_spread": 0.3},
    "hard-brakes": {"hard_brakers": 0.5},
    "trucks": {"trucks": 0.3},
    "sway": {"sway_m": 0.3},
    "narrow": {},
}
"""What `Scenario.varied` takes; "narrow": lanes of `NARROW_M`."""
NARROW_M = 3.2


def draw(manners: Manners, rng: Generator, x: Any, lane: Any) -> NDArray[np.float64]:
    """(V, 11) for cars at x (V,) [m] in the lanes (V,), the ego first, which is plain."""
    n = len(x)
    table = np.tile(PLAIN, (n, 1))
    if manners.plain or n < 2:
        return table
    if manners.idm_spread:
        spread = rng.uniform(1.0 - manners.idm_spread, 1.0 + manners.idm_spread, (n - 1, 4))
        table[1:, IDM_ACCEL : IDM_TIME + 1] *= spread
    if manners.hard_brakers:
        chosen, begin = rng.random(n - 1) < manners.hard_brakers, rng.uniform(*manners.hard_at_s, n - 1)
        last, how = rng.uniform(*manners.hard_s, n - 1), rng.uniform(*manners.hard_mps2, n - 1)
        rows = 1 + np.flatnonzero(chosen & (x[1:] > x[0]))
        table[rows, HARD_FROM : HARD_MPS2 + 1] = np.stack([begin, begin + last, how], axis=1)[rows - 1]
    if manners.trucks:
        chosen, lengths = rng.random(n - 1) < manners.trucks, rng.uniform(*manners.truck_m, n - 1)
        for i in 1 + np.flatnonzero(chosen):
            beside = [j for j in range(n) if j != i and lane[j] == lane[i]]
            room = [abs(x[j] - x[i]) - 0.5 * (table[j, CAR_LENGTH] + lengths[i - 1]) for j in beside]
            if min(room, default=math.inf) >= START_GAP_M:
                table[i, CAR_LENGTH] = lengths[i - 1]
    if manners.sway_m:
        table[1:, SWAY_M] = manners.sway_m
        table[1:, SWAY_RATE] = 2.0 * math.pi / rng.uniform(*manners.sway_s, n - 1)
        table[1:, SWAY_PHASE] = rng.uniform(0.0, 2.0 * math.pi, n - 1)
    return table
