"""How the ego moves where plans are tried out on paper: as the executor steps its set-point and follows it, and as
`choice.comfortable_mps` keeps it behind its leader. Arrays of any shape, SI."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.driving.features import Array

ACCEL_MPS2, MOST_MPS2 = 1.5, 1.8
SLOWEST_MPS = 3.0
SPARE_MPS = 0.3
"""A falling set-point is no more than this above the speed."""
STANDSTILL_M = 2.5
NEAREST = (6.0 - 2.5) ** 2
"""Too near to a leader the ego is 2.5 m/s slower than it, as `choice.closing_mps` has it."""


RIGHT_MPS, EXACT_MPS = 0.3, 0.05
"""A set-point that is off by less is right: a decision moves it by half a metre a second, and more would be flutter;
but the wished speed, at which it stops, is reached."""


def way(goal: Array, held: Array, wished: Array) -> NDArray[np.int64]:
    """-1, 0, 1: whether a set-point `held` has to fall, is right or has to rise for `goal` [m/s]."""
    off = goal - held
    right = np.where(np.abs(goal - wished) < EXACT_MPS, EXACT_MPS, RIGHT_MPS)
    return np.where(off < -right, -1, np.where(off > right, 1, 0))


def set_point(point: Array, goal: Array, speed: Array, dt: Any) -> Array:
    """Where the set-point [m/s] is `dt` seconds on, on its way to `goal`."""
    step = ACCEL_MPS2 * dt
    down = np.maximum(goal, np.minimum(point, speed + SPARE_MPS) - step)
    return np.where(point < goal, np.minimum(goal, point + step), down)


def acceleration(point: Array, speed: Array, lead_mps: Array, spare_m: Array, hardest_mps2: float) -> Array:
    """Towards the set-point, but no faster than what is comfortable `spare_m` before the wished gap to a leader is
    reached; braking with `hardest_mps2` at most."""
    admitted = lead_mps + np.sqrt(np.maximum(3.0 * spare_m + 36.0, NEAREST)) - 6.0
    return np.asarray(np.minimum(np.maximum(np.minimum(point, admitted) - speed, -hardest_mps2), MOST_MPS2))
