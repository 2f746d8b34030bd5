"""The paper's reward (Eq. 4), R = R_safe + R_eff + R_comfort + R_pref: one definition for every learner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SCALE = 0.1
"""Returns near 1: unscaled rewards with a joint gradient clip make baselines straw men."""
CRASH = -10.0
BRAKE = -0.3
NEAR = -0.3
"""For coming within `NEAR_S` of a collision, rising as the smallest time to collision falls to 0."""
NEAR_S = 10.0
COMFORT = -0.05
"""Per (m/s2)^2 of mean squared acceleration."""
STEP = -0.02
"""For any action but CRUISE."""
LANE = 0.3
OVERSPEED = 1.5
"""Too fast counts this much more than too slow."""

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def reward(
    speed: Floats, v_des: Floats, speed_range: float, accel_square: Floats, acted: Bools, in_wished_lane: Bools,
    ttc_s: Floats,
    braked: Bools, crashed: Bools,
) -> NDArray[np.float32]:
    """(S,) reward of one second; a step of 1/15 s earns a fifteenth of the running terms.

    speed: mean over the second [m/s]; v_des [m/s]; speed_range: what the efficiency term divides by [m/s];
    accel_square: mean of a^2 [(m/s2)^2]; acted: any action but CRUISE; in_wished_lane: aims for it, or none is wished;
    ttc_s: the smallest time to collision meanwhile; braked: the mask braked at some tick.
    """
    slow = np.abs(speed - v_des) / speed_range * np.where(speed > v_des, OVERSPEED, 1.0)
    total = (0.6 - slow + LANE * in_wished_lane + COMFORT * accel_square + STEP * acted + BRAKE * braked
             + NEAR * np.clip(1.0 - ttc_s / NEAR_S, 0.0, 1.0) + CRASH * crashed)
    return np.asarray(SCALE * total, np.float32)
