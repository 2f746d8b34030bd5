"""Gap, time to collision and RSS distances: one definition for the mask, the prompt and the metrics.

Plain arithmetic on floats: the functions run as they are in the nodes, and compile unchanged with numba for training.
Speeds are along the lane, in m/s; distances bumper to bumper, in m; accelerations are magnitudes, in m/s2.
"""

from __future__ import annotations

import math

CAR_LENGTH_M = 5.0
INF = math.inf
TTC_CAP_S = 100.0
"""Where a smallest time to collision is asked for and nothing is approached."""


def gap_m(rear_x: float, front_x: float, rear_length: float, front_length: float) -> float:
    """Bumper-to-bumper distance from the rear car to the front car; negative when they overlap."""
    return front_x - rear_x - 0.5 * (rear_length + front_length)


def ttc_s(gap: float, closing_mps: float) -> float:
    """Time to collision: gap / closing speed; inf when the gap opens (closing below 0.1 m/s), 0 when touching."""
    if gap <= 0.0:
        return 0.0
    if closing_mps <= 0.1:
        return INF
    return gap / closing_mps


def rss_same_direction_m(
    rear_mps: float, front_mps: float, reaction_s: float, accel: float, brake_min: float, brake_max: float
) -> float:
    """Smallest gap from which the rear car can always stop behind the front car.

    RSS safe longitudinal distance, same direction (Shalev-Shwartz et al. 2017, Definition 1):
    [v_r*rho + a*rho^2/2 + (v_r + rho*a)^2/(2*b_min) - v_f^2/(2*b_max)]+ with v_r, v_f >= 0.
    """
    v_rho = rear_mps + reaction_s * accel
    distance = (
        rear_mps * reaction_s
        + 0.5 * accel * reaction_s * reaction_s
        + v_rho * v_rho / (2.0 * brake_min)
        - front_mps * front_mps / (2.0 * brake_max)
    )
    return max(distance, 0.0)


def rss_opposite_m(
    ego_mps: float, other_mps: float, reaction_s: float, accel: float, brake_correct: float, brake_min: float
) -> float:
    """Smallest gap from which two cars that drive towards each other can both stop before they meet.

    RSS safe longitudinal distance, opposite direction (Shalev-Shwartz et al. 2017, Definition 2); the ego is the car
    in the wrong lane and brakes with `brake_min`, the other is in its own and brakes with `brake_correct`.
    """
    ego_rho = ego_mps + reaction_s * accel
    other_rho = other_mps + reaction_s * accel
    return (
        0.5 * (ego_mps + ego_rho) * reaction_s
        + ego_rho * ego_rho / (2.0 * brake_min)
        + 0.5 * (other_mps + other_rho) * reaction_s
        + other_rho * other_rho / (2.0 * brake_correct)
    )


def rss_lateral_m(
    toward_mps: float, other_toward_mps: float, reaction_s: float, accel: float, brake: float, sway: float
) -> float:
    """Smallest lateral distance, side to side, from which two cars beside each other can both stay apart.

    RSS safe lateral distance (Shalev-Shwartz et al. 2017, Definition 6): for the response time each accelerates with
    `accel` towards the other, then brakes sideways with `brake` until it moves sideways no more; `sway` is the margin
    mu for what is no motion. Speeds are those towards the other car. One that is still moving away after its response
    time comes no nearer by braking: its term has the sign of that speed.
    """
    speed = toward_mps + reaction_s * accel
    other = other_toward_mps + reaction_s * accel
    distance = (
        0.5 * (toward_mps + speed) * reaction_s
        + 0.5 * speed * abs(speed) / brake
        + 0.5 * (other_toward_mps + other) * reaction_s
        + 0.5 * other * abs(other) / brake
    )
    return sway + max(distance, 0.0)


# What the ego's executor can do: the mask's claims rest on these, and the executor keeps them.
EGO_BRAKE_MAX_MPS2 = 8.0
SPEED_STEP_MPS = 0.1
"""One SLOW_DOWN or SPEED_UP; held for a second they change the set-point by 1.5 m/s."""
LANE_CHANGE_DONE_M = 0.3
"""A lane change is over once the ego's centre is this close to the target lane's centre line."""
