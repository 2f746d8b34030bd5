"""The paper's reward (Eq. 4), R = R_safe + R_eff + R_comfort + R_pref: one definition for every learner."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SCALE = 0.1
"""Returns near 1: unscaled rewards with a joint gradient clip make baselines straw men."""
CRASH = -10.0
BRAKE = -0.3
NEAR = -1.5
"""For coming within `NEAR_S` of a collision, rising as the smallest time to collision falls to 0."""
NEAR_S = 8.0
SHORT = -0.3
"""For keeping less than the wished headway to the leader, rising as the gap falls to `STANDSTILL_M` and below."""
STANDSTILL_M = 2.0
COMFORT = -0.15
"""Per (m/s2)^2 of mean squared acceleration."""
JERK = -0.05
"""Per (m/s3)^2 of mean squared jerk."""
CHANGE = -0.1
"""For a lane change, or giving one up."""
ACT = -0.01
"""For any action but CRUISE: the set-point is not to flutter."""
LANE = 0.5
MISSED = -8.0
"""For driving past the place that had to be reached, in a lane that does not lead there."""
OVERSPEED = 1.5
"""Too fast counts this much more than too slow."""


class Weights(NamedTuple):
    """What each term counts; by default the constants above, which the policies of this repository learn by."""

    scale: float = SCALE
    crash: float = CRASH
    brake: float = BRAKE
    near: float = NEAR
    short: float = SHORT
    comfort: float = COMFORT
    jerk: float = JERK
    change: float = CHANGE
    act: float = ACT
    lane: float = LANE
    missed: float = MISSED
    overspeed: float = OVERSPEED


OURS = Weights()


Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def reward(
    speed: Floats,
    v_des: Floats,
    speed_range: float,
    accel_square: Floats,
    jerk_square: Floats,
    acted: Bools,
    changes: Bools,
    in_wished_lane: Bools,
    ttc_s: Floats,
    short: Floats,
    braked: Bools,
    crashed: Bools,
    seconds: float | Floats = 1.0,
    missed: Bools | bool = False,
    weights: Weights = OURS,
) -> NDArray[np.float32]:
    """(S,) reward of one decision that lasted `seconds`; what happens once (an action, a brake, a crash) counts whole.

    speed: mean over the decision [m/s]; v_des [m/s]; speed_range: what the efficiency term divides by [m/s];
    accel_square: mean of a^2 [(m/s2)^2]; jerk_square: of its change [(m/s3)^2]; acted: any action but CRUISE; changes:
    LEFT or RIGHT; in_wished_lane: aims for it, or none is wished; ttc_s: the smallest time to collision meanwhile;
    short: mean of `shortfall`; braked: the mask braked at some tick; missed: the goal was driven past.
    """
    w = weights
    slow = np.abs(speed - v_des) / speed_range * np.where(speed > v_des, w.overspeed, 1.0)
    running = (
        0.6
        - slow
        + w.lane * in_wished_lane
        + w.comfort * accel_square
        + w.jerk * np.minimum(jerk_square, 25.0)
        + w.near * np.clip(1.0 - ttc_s / NEAR_S, 0.0, 1.0)
        + w.short * short
    )
    total = (
        seconds * running
        + w.act * acted
        + w.change * changes
        + w.brake * braked
        + w.crash * crashed
        + w.missed * missed
    )
    return np.asarray(w.scale * total, np.float32)


def shortfall(gap: float, speed: float, headway_s: float) -> float:
    """How far the gap [m] to the leader is below the wished headway: 0 at or above it, 1 at `STANDSTILL_M` or less."""
    wanted = headway_s * max(speed, 0.0)
    if wanted <= 0.0:
        return 0.0
    return min(max(1.0 - (gap - STANDSTILL_M) / wanted, 0.0), 1.0)
