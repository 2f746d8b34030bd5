"""What the kernel works on: its arrays, the names of their rows, and highway-env's constants."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_node.engine.loops import addresses

X, Y, ANGLE, SPEED, TARGET_SPEED, DELTA, TIMER, STEERING, ACCEL, PUSH_X, PUSH_Y, CAR_LENGTH, CAR_WIDTH = range(13)
AGE, IDM_ACCEL, IDM_GAP, IDM_TIME, IDM_DIVISOR, HARD_FROM, HARD_TO, HARD_MPS2, SWAY_M, SWAY_RATE, SWAY_PHASE = range(
    13, 24
)
"""Rows of the float state (S, 24, V). PUSH: the impact of a collision, applied at the next step. AGE: seconds that a
TRAFFIC car has driven. IDM_...: of IDM and TRAFFIC cars; DIVISOR: 2 * sqrt(acceleration * braking). The others: see
`sim_node.scenarios.manners`."""
FLOATS = 24
KIND, LANE, TARGET_LANE, CRASHED, PUSHED, CHANGES, CHECKS, SPEED_INDEX = range(8)
"""Rows of the int state (S, 8, V). CHANGES: `enable_lane_change`; CHECKS: `check_collisions`."""
INTS = 8
ABSENT, IDM, TRAFFIC, MDP, EXECUTOR, OBSTACLE = range(6)
"""Kinds of vehicles: upstream's IDMVehicle, our TrafficVehicle, upstream's MDPVehicle, our EgoVehicle, Obstacle."""
NO_ACTION = -1
LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)
"""Meta-actions of an MDP ego, as `DiscreteMetaAction.ACTIONS_ALL`; an EXECUTOR ego takes `schemas.wire.messages`'."""
ABSENT_X_M = 1e6
"""Vehicles that have left are here: nobody's neighbour."""

# highway-env's constants; tests/test_engine.py compares them with the installed version.
ACC_MAX = 6.0
LANE_CHANGE_MIN_ACC_GAIN = 0.2
LANE_CHANGE_MAX_BRAKING_IMPOSED = 2.0
LANE_CHANGE_DELAY = 1.0
MAX_SPEED = 40.0
MIN_SPEED = -40.0
KP_A = 1 / 0.6
KP_HEADING = 1 / 0.2
KP_LATERAL = 1 / 0.6
TAU_PURSUIT = 0.5 * 0.2
MAX_STEERING_ANGLE = np.pi / 3
LANE_END_M = 5.0
VEHICLE_WIDTH_M = 2.0
HALF_PI, QUARTER_PI, TWO_PI = np.pi / 2, np.pi / 4, 2 * np.pi
CLEAR = 1e-6
"""Distances differ by this much before a cheap test may stand for the exact one: far above any rounding, in m."""


class Calls(NamedTuple):
    """What a call into numpy takes; see `loops`. Neither these nor `Scratch` may be shared by threads."""

    loops: NDArray[np.int64]
    args: NDArray[np.int64]
    box: NDArray[np.float64]


class Scratch(NamedTuple):
    """Working memory of one scene's tick."""

    cos: NDArray[np.float64]
    sin: NDArray[np.float64]
    free: NDArray[np.float64]
    a: NDArray[np.float64]
    b: NDArray[np.float64]
    c: NDArray[np.float64]
    slip_sine: NDArray[np.float64]
    angle: NDArray[np.float64]
    diagonal: NDArray[np.float64]
    some: NDArray[np.int64]
    polygons: NDArray[np.float64]
    on: NDArray[np.int64]
    """(L,) how many vehicles are on a lane; -1: not counted yet in this tick."""
    cars: NDArray[np.int64]
    places: NDArray[np.float64]


class Ego(NamedTuple):
    """Vehicle 0 of every scene: its set-points, and what it may be asked for."""

    meta: NDArray[np.int64]
    """(S,) the last action."""
    speed_goal: NDArray[np.float64]
    speed_cap: NDArray[np.float64]
    """(S,) m/s; inf: none."""
    style: NDArray[np.int64]
    """(S,) 0 calm, 1 normal, 2 assertive."""
    target_speed: NDArray[np.float64]
    target_lane: NDArray[np.int64]
    """(S,) index in the scenario's lanes."""
    previous_lane: NDArray[np.int64]
    accel: NDArray[np.float64]
    """(S,) what the last tick did to the speed, m/s2."""
    crashed: NDArray[np.bool_]
    ticks: NDArray[np.int64]
    speeds: NDArray[np.float64]
    """Target speeds of an MDP ego, evenly spaced."""
    pieces: NDArray[np.float64]
    """(P, 7) as `Scenario.pieces`."""
    gates: NDArray[np.float64]
    """(L, 4) as `Scenario.gates`."""
    floor: float
    ceiling: float
    freezes: bool
    """A scene whose ego has crashed stands still."""


EGO_STATE = (
    "meta",
    "speed_goal",
    "speed_cap",
    "style",
    "target_speed",
    "target_lane",
    "previous_lane",
    "accel",
    "crashed",
    "ticks",
)
"""What of `Ego` a scene has of its own."""


class View(NamedTuple):
    """What is published of every scene after a tick; nothing if `rows` has no scenes."""

    rows: NDArray[np.float32]
    """(S, V, 9) as `ROW_COLUMNS`; id -1 for what is absent or out of sight, which is then at `ABSENT_X_M`."""
    lanes: NDArray[np.float64]
    """(L, 3) in the first columns of `road.lane_table`: y (nan: curved), start, end."""
    lane_y: NDArray[np.float64]
    """(S, L) y of every lane beside the ego."""
    lane_of: NDArray[np.int64]
    """(N,) the scenario's lane that a lane of the network belongs to."""
    end_x: float
    """Vehicles leave the road here, and at `scenario.LEFT_ROAD_M` in the other direction."""
    sight: float


def set_manners(f: NDArray[np.float64], i: int, row: Any) -> None:
    """Give car `i` of a scene's floats (FLOATS, V) a row of `Spawn.manners`."""
    accel, brake, gap, time, length, *rest = row
    f[CAR_LENGTH, i] = length
    f[IDM_ACCEL, i], f[IDM_GAP, i], f[IDM_TIME, i], f[IDM_DIVISOR, i] = accel, gap, time, 2 * np.sqrt(accel * brake)
    f[HARD_FROM : SWAY_PHASE + 1, i] = rest


def new_calls() -> Calls:
    """Fresh `Calls` of this process."""
    return Calls(addresses(), np.zeros(16, np.int64), np.zeros(8))


def new_scratch(vehicles: int, lanes: int) -> Scratch:
    """Fresh working memory."""
    rows = np.zeros((9, vehicles))
    cos, sin, free, a, b, c, slip_sine, angle, diagonal = rows
    return Scratch(
        cos,
        sin,
        free,
        a,
        b,
        c,
        slip_sine,
        angle,
        diagonal,
        np.zeros(vehicles, np.int64),
        np.zeros((2, 5, 2)),
        np.zeros(lanes, np.int64),
        np.zeros((lanes, vehicles), np.int64),
        np.zeros((lanes, vehicles)),
    )
