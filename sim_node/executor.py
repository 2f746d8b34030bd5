"""The ego's executor: from a meta-action to set-points, and from set-points to acceleration and steering.

Plain arithmetic on floats and ints: the functions run as they are in the real-time node, and compile unchanged with
numba for training. SI units; the y axis grows to the right, so a positive steering angle turns towards growing lanes.
"""

from __future__ import annotations

import math
from typing import Any

from schemas.driving.measures import CAR_LENGTH_M, EGO_BRAKE_MAX_MPS2, LANE_CHANGE_DONE_M, SPEED_STEP_MPS
from schemas.wire.messages import MetaAction
from sim_node.scenarios.scenario import GATE_END, GATE_OPENS, GATE_RAMP, GATE_START

# numba freezes global ints, but does not know IntEnum members in arithmetic comparisons with plain ints.
SLOW_DOWN = int(MetaAction.SLOW_DOWN)
SPEED_UP = int(MetaAction.SPEED_UP)
CRUISE = int(MetaAction.CRUISE)
LEFT = int(MetaAction.LEFT)
RIGHT = int(MetaAction.RIGHT)
EMERGENCY_BRAKE = int(MetaAction.EMERGENCY_BRAKE)

SPEED_GAIN_PER_S = 1.0
"""Acceleration per speed error: an error of 2.5 m/s brakes with 2.5 m/s2."""
STYLE_ACCEL_MPS2 = (1.2, 1.8, 2.5)
STYLE_JERK_UP_MPS3 = (1.0, 2.0, 3.0)
"""How a calm, a normal and an assertive ride speed up."""
EASE_JERK_MPS3 = 2.0
"""No style lets a brake go more slowly than this, or it would brake to well below the speed that is asked for."""
JERK_DOWN_MPS3 = 4.0
COMFORT_BRAKE_MPS2 = 3.0
BRAKE_RELEASE_JERK_MPS3 = 12.0
"""A brake harder than comfort is let go this fast; at the comfort jerk one emergency tick would cost 6 m/s of speed."""

LATERAL_GAIN_PER_S = 1.7
LATERAL_SPEED_MAX_MPS = 2.5
LATERAL_ACCEL_MAX_MPS2 = 6.0
HEADING_GAIN_PER_S = 5.0
HEADING_MAX_RAD = 0.6
STEERING_MAX_RAD = 0.5
STEERING_SPEED_MIN_MPS = 0.5
"""Below this speed steering would only turn the car on the spot."""
HALF_WHEELBASE_M = 0.5 * CAR_LENGTH_M
"""Half of the car's length, as highway-env's bicycle model has it."""


def lane_beside(gates: Any, lane: int, aim: int, x: float) -> bool:
    """Whether a car in `lane` can change to `aim` at `x` (m): it exists there, lies beside it, and is no ramp."""
    if aim < 0 or aim >= len(gates):
        return False
    there, here = gates[aim], gates[lane]
    fits: bool = there[GATE_START] <= x <= there[GATE_END] and x >= here[GATE_OPENS] and there[GATE_RAMP] == 0.0
    return fits


def edit_set_points(
    meta: int,
    target_speed: float,
    target_lane: int,
    previous_lane: int,
    gates: Any,
    x: float,
    speed_goal: float,
    speed_floor: float,
    speed_ceiling: float,
    speed_cap: float,
) -> tuple[float, int, int]:
    """Apply one meta-action once: (target speed in m/s, target lane, previous lane or -1).

    A speed step towards `speed_goal` (m/s; nan: none) stops at it. Steps stay within [`speed_floor`, `speed_ceiling`].
    SLOW_DOWN steps down from the speed that `speed_cap` (m/s; inf: none) admits, so that it always slows down.
    While a lane change is under way (`previous_lane` >= 0) the same direction is ignored and the opposite gives it up.
    gates: (L, 4) as `Scenario.gates`; a change needs a lane beside the ego at `x` (m).
    """
    if meta == SLOW_DOWN:
        admitted = min(target_speed, max(speed_cap, speed_floor))
        stepped = max(admitted - SPEED_STEP_MPS, speed_floor)
        if stepped < speed_goal < admitted:  # false for nan
            stepped = speed_goal
        return stepped, target_lane, previous_lane
    if meta == SPEED_UP:
        stepped = min(target_speed + SPEED_STEP_MPS, speed_ceiling)
        if target_speed < speed_goal < stepped:
            stepped = speed_goal
        return stepped, target_lane, previous_lane
    if meta in (LEFT, RIGHT):
        step = 1 if meta == RIGHT else -1
        if previous_lane >= 0:
            if (previous_lane - target_lane) * step > 0:
                return target_speed, previous_lane, target_lane
            return target_speed, target_lane, previous_lane
        if lane_beside(gates, target_lane, target_lane + step, x):
            return target_speed, target_lane + step, target_lane
    return target_speed, target_lane, previous_lane


def able(
    gates: Any,
    target_speed: float,
    target_lane: int,
    previous_lane: int,
    x: float,
    speed_floor: float,
    speed_ceiling: float,
    out: Any,
) -> None:
    """Fill `out` (5,) with which meta-actions do anything now: the lane exists here, one change at a time, speed within
    its bounds. The arguments are those of `edit_set_points`. Compiles with numba unchanged."""
    out[SLOW_DOWN], out[CRUISE], out[SPEED_UP] = target_speed > speed_floor, True, target_speed < speed_ceiling
    for action, step in ((LEFT, -1), (RIGHT, 1)):
        aim = target_lane + step
        if previous_lane >= 0:
            out[action] = aim == previous_lane
        else:
            out[action] = lane_beside(gates, target_lane, aim, x)


def acceleration_command(
    speed: float, target_speed: float, last_accel: float, meta: int, style: int, dt: float
) -> float:
    """Longitudinal acceleration for the next `dt` s, in [-8, 2.5] m/s2; never drives backwards.

    Proportional to the speed error with bounded jerk; EMERGENCY_BRAKE brakes fully at once. style: 0 calm, 1 normal,
    2 assertive (`STYLE_ACCEL_MPS2`).
    """
    if meta == EMERGENCY_BRAKE:
        accel = -EGO_BRAKE_MAX_MPS2
    else:
        jerk = STYLE_JERK_UP_MPS3[style]
        if last_accel < 0.0:
            jerk = max(jerk, EASE_JERK_MPS3)
        up = last_accel + jerk * dt
        if last_accel < -COMFORT_BRAKE_MPS2:
            up = min(last_accel + BRAKE_RELEASE_JERK_MPS3 * dt, -COMFORT_BRAKE_MPS2 + jerk * dt)
        accel = SPEED_GAIN_PER_S * (target_speed - speed)
        accel = min(max(accel, last_accel - JERK_DOWN_MPS3 * dt), up)
        accel = min(max(accel, -EGO_BRAKE_MAX_MPS2), STYLE_ACCEL_MPS2[style])
    # Standstill ends any braking: the car stops within this tick and does not roll back.
    return max(accel, -max(speed, 0.0) / dt)


def steering_command(y: float, heading: float, speed: float, y_target: float, lane_heading: float) -> float:
    """Front-wheel angle in rad that brings the car to the centre line, at `y_target` (m) and turned by `lane_heading`.

    highway-env's cascade (position -> lateral speed -> heading -> heading rate -> angle) with bounded lateral speed
    and bounded lateral acceleration, so that a change looks the same at 5 and at 25 m/s. A slow
    bend (the ramp) is followed by its heading alone.
    """
    if speed < STEERING_SPEED_MIN_MPS:
        return 0.0
    lateral = LATERAL_GAIN_PER_S * (y_target - y)
    lateral = min(max(lateral, -LATERAL_SPEED_MAX_MPS), LATERAL_SPEED_MAX_MPS)
    heading_wanted = lane_heading + math.asin(min(max(lateral / speed, -1.0), 1.0))
    heading_wanted = min(max(heading_wanted, -HEADING_MAX_RAD), HEADING_MAX_RAD)
    rate_max = LATERAL_ACCEL_MAX_MPS2 / speed
    rate = min(max(HEADING_GAIN_PER_S * (heading_wanted - heading), -rate_max), rate_max)
    slip = math.asin(min(max(HALF_WHEELBASE_M * rate / speed, -1.0), 1.0))
    # The car moves along heading + slip: capped so, it never moves more sideways than wanted, however slow it is.
    slip_max = abs(heading_wanted - heading)
    slip = min(max(slip, -slip_max), slip_max)
    steering = math.atan(2.0 * math.tan(slip))
    return min(max(steering, -STEERING_MAX_RAD), STEERING_MAX_RAD)


def change_finished(y: float, y_target: float) -> bool:
    """Whether the ego's centre has reached the target lane; then the previous lane becomes -1."""
    return abs(y_target - y) <= LANE_CHANGE_DONE_M
