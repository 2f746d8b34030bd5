"""Where a point is on a lane, which lane is nearest, and which lane follows; with the arithmetic that all share."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim_node.engine.kernel.layout import CLEAR, LANE_END_M, TWO_PI
from sim_node.engine.loops import ARCTAN, COS, SIN, one
from sim_node.engine.tables import (
    AMPLITUDE,
    COUNT,
    FIRST,
    FORBIDDEN,
    HEADING,
    LENGTH,
    NEXT,
    NEXT_END,
    PHASE,
    PULSATION,
    WAY,
    WIDTH,
    X0,
    Y0,
)


def clip(x: float, low: float, high: float) -> float:
    return min(max(x, low), high)


def not_zero(x: float) -> float:
    if abs(x) > 1e-2:
        return x
    return 1e-2 if x >= 0 else -1e-2


def wrap(x: float) -> float:
    shifted = x + np.pi
    if 0.0 <= shifted < TWO_PI:  # the modulo would return it as it is
        return shifted - np.pi
    return shifted % TWO_PI - np.pi


def along(lane: Any, x: float) -> float:
    """Longitudinal coordinate."""
    return float((x - lane[X0]) * lane[WAY])


def across(calls: Any, lane: Any, s: float, y: float) -> float:
    """Lateral coordinate at the longitudinal one `s`."""
    r = (y - lane[Y0]) * lane[WAY]
    if lane[AMPLITUDE] == 0.0:
        return float(r)
    return float(r - lane[AMPLITUDE] * one(calls.loops, SIN, calls.args, calls.box, lane[PULSATION] * s + lane[PHASE]))


def heading_at(calls: Any, lane: Any, s: float) -> float:
    if lane[AMPLITUDE] == 0.0:
        return float(lane[HEADING])
    bend = one(calls.loops, COS, calls.args, calls.box, lane[PULSATION] * s + lane[PHASE])
    slope = lane[AMPLITUDE] * lane[PULSATION] * bend
    return float(lane[HEADING] + one(calls.loops, ARCTAN, calls.args, calls.box, slope))


def closest_lane(calls: Any, roads: Any, x: float, y: float, heading: float) -> int:
    """RoadNetwork.get_closest_lane_index."""
    best, nearest = 0, np.inf
    for k in range(roads.lanes.shape[0]):
        lane = roads.lanes[k]
        s = along(lane, x)
        beyond, before = max(s - lane[LENGTH], 0.0), max(0.0 - s, 0.0)
        if lane[AMPLITUDE] != 0.0:
            at_least = abs(y - lane[Y0]) - abs(lane[AMPLITUDE]) - CLEAR
            if max(at_least, beyond, before) > nearest:
                continue
        distance = abs(across(calls, lane, s, y)) + beyond + before
        if distance >= nearest:  # the angle cannot make it less
            continue
        distance += abs(wrap(heading - heading_at(calls, lane, s)))
        if distance < nearest:
            best, nearest = k, distance
    return best


def reachable(calls: Any, lane: Any, x: float, y: float) -> bool:
    """AbstractLane.is_reachable_from."""
    if lane[FORBIDDEN] != 0.0:
        return False
    s = along(lane, x)
    return bool(0 <= s < lane[LENGTH] + LANE_END_M and abs(across(calls, lane, s, y)) <= 2 * lane[WIDTH])


def follow_road(calls: Any, roads: Any, target: int, x: float, y: float) -> int:
    """ControlledVehicle.follow_road without a route: the target lane."""
    lane = roads.lanes[target]
    s = along(lane, x)
    if not s > lane[LENGTH] - LANE_END_M / 2 or roads.graph[target, NEXT] == roads.graph[target, NEXT_END]:
        return target
    lateral = 0.0
    if lane[AMPLITUDE] != 0.0:
        lateral += lane[AMPLITUDE] * one(calls.loops, SIN, calls.args, calls.box, lane[PULSATION] * s + lane[PHASE])
    px = lane[X0] + s * lane[WAY]
    py = lane[Y0] + lateral * lane[WAY]
    chosen, nearest = target, np.inf
    for e in range(roads.graph[target, NEXT], roads.graph[target, NEXT_END]):
        first, count = roads.nexts[e, FIRST], roads.nexts[e, COUNT]
        low, high = first, first + count
        if roads.graph[target, COUNT] == count:
            low = first + target - roads.graph[target, FIRST]
            high = low + 1
        of_edge, distance_of_edge = low, np.inf
        for k in range(low, high):
            other = roads.lanes[k]
            s_other = along(other, px)
            distance = abs(across(calls, other, s_other, py)) + max(s_other - other[LENGTH], 0.0) + max(-s_other, 0.0)
            if distance < distance_of_edge:
                of_edge, distance_of_edge = k, distance
        if distance_of_edge < nearest:
            chosen, nearest = of_edge, distance_of_edge
    return int(chosen)
