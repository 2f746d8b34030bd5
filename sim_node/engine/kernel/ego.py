"""The ego's set-points and controls, what is known of it after a tick, and what is published of the scene."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from schemas.driving import road
from sim_node.engine.kernel.drivers import command
from sim_node.engine.kernel.layout import (
    ABSENT,
    ABSENT_X_M,
    ACCEL,
    ANGLE,
    CAR_LENGTH,
    CAR_WIDTH,
    CRASHED,
    EXECUTOR,
    KIND,
    LANE,
    MDP,
    SPEED,
    STEERING,
    TARGET_LANE,
    Ego,
    View,
    X,
    Y,
)
from sim_node.executor import acceleration_command, change_finished, edit_set_points, steering_command
from sim_node.scenarios.scenario import LEFT_ROAD_M, centre_line


def set_controls(ego: Ego, f: Any, scene: int, dt: float) -> None:
    """EgoVehicle.act without an action: the controls of an EXECUTOR ego."""
    y_target, lane_heading = centre_line(ego.pieces, ego.target_lane[scene], f[X, 0])
    f[STEERING, 0] = steering_command(f[Y, 0], f[ANGLE, 0], f[SPEED, 0], y_target, lane_heading)
    f[ACCEL, 0] = acceleration_command(
        f[SPEED, 0],
        min(ego.target_speed[scene], ego.speed_cap[scene]),
        ego.accel[scene],
        ego.meta[scene],
        ego.style[scene],
        dt,
    )


def begin(calls: Any, roads: Any, ego: Ego, f: Any, g: Any, scene: int, action: int) -> None:
    """Edit the ego's set-points by its action."""
    if g[KIND, 0] == MDP:
        command(calls, roads, f, g, 0, action, ego.speeds)
    elif g[KIND, 0] == EXECUTOR:
        ego.meta[scene] = action
        ego.target_speed[scene], ego.target_lane[scene], ego.previous_lane[scene] = edit_set_points(
            action,
            ego.target_speed[scene],
            ego.target_lane[scene],
            ego.previous_lane[scene],
            ego.gates,
            f[X, 0],
            ego.speed_goal[scene],
            ego.floor,
            ego.ceiling,
            ego.speed_cap[scene],
        )
    elif not np.isnan(ego.speed_goal[scene]):  # an IDM ego takes no actions, but knows how fast it is to be
        ego.target_speed[scene] = ego.speed_goal[scene]


def _lane_at(ego: Ego, view: View, x: float, y: float) -> int:
    """ScenarioEnv.lane_at."""
    best, nearest = 0, np.inf
    for k in range(view.lanes.shape[0]):
        if view.lanes[k, road.LANE_START] <= x <= view.lanes[k, road.LANE_END]:
            centre = view.lanes[k, road.LANE_Y]
            if np.isnan(centre):
                centre = centre_line(ego.pieces, k, x)[0]
            if abs(centre - y) < nearest:
                best, nearest = k, abs(centre - y)
    return best


def publish(ego: Ego, view: View, scratch: Any, f: Any, g: Any, scene: int) -> None:
    """Take vehicles that have left off the road, and write the rows."""
    rows = view.rows
    for k in range(view.lanes.shape[0]):
        y = view.lanes[k, road.LANE_Y]
        view.lane_y[scene, k] = centre_line(ego.pieces, k, f[X, 0])[0] if np.isnan(y) else y
    for i in range(rows.shape[1]):
        seen = g[KIND, i] != ABSENT
        x, y = f[X, i], f[Y, i]
        if seen and i > 0 and not (x < view.end_x if scratch.cos[i] > 0 else x > LEFT_ROAD_M):
            g[KIND, i] = ABSENT
            f[X, i], f[SPEED, i] = ABSENT_X_M, 0.0
            seen = False
        if seen and i > 0:
            seen = math.hypot(x - f[X, 0], y - f[Y, 0]) <= view.sight
        row = rows[scene, i]
        if not seen:
            row[road.ID], row[road.X], row[road.VX], row[road.VY] = road.NOBODY, ABSENT_X_M, 0.0, 0.0
            continue
        row[road.ID], row[road.X], row[road.Y], row[road.HEADING] = i, x, y, f[ANGLE, i]
        row[road.VX], row[road.VY] = f[SPEED, i] * scratch.cos[i], f[SPEED, i] * scratch.sin[i]
        row[road.LENGTH], row[road.WIDTH], row[road.LANE] = f[CAR_LENGTH, i], f[CAR_WIDTH, i], _lane_at(ego, view, x, y)


def finish(ego: Ego, view: View, f: Any, g: Any, scene: int, before: float, dt: float) -> None:
    """What is known of the ego after a tick."""
    ego.accel[scene] = (f[SPEED, 0] - before) / dt
    ego.crashed[scene] = g[CRASHED, 0] != 0
    ego.ticks[scene] += 1
    if g[KIND, 0] == EXECUTOR:
        if ego.previous_lane[scene] >= 0 and change_finished(
            f[Y, 0], centre_line(ego.pieces, ego.target_lane[scene], f[X, 0])[0]
        ):
            ego.previous_lane[scene] = -1
    elif g[KIND, 0] != MDP and view.rows.shape[0] > 0:
        ego.target_lane[scene] = view.lane_of[g[TARGET_LANE, 0]]
        lane = view.lane_of[g[LANE, 0]]
        ego.previous_lane[scene] = lane if lane != ego.target_lane[scene] else -1
