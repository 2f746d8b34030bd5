"""Between highway-env's objects and the kernel's arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.objects import Obstacle
from numpy.typing import NDArray

from schemas.driving.measures import CAR_LENGTH_M
from schemas.wire.messages import ROW_COLUMNS
from sim_node.ego import EgoVehicle
from sim_node.engine import tables
from sim_node.engine.kernel import layout
from sim_node.engine.kernel.layout import Ego, Scratch, View
from sim_node.engine.tables import UnsupportedError
from sim_node.traffic import TrafficVehicle

KINDS: dict[type, int] = {
    IDMVehicle: layout.IDM,
    TrafficVehicle: layout.TRAFFIC,
    MDPVehicle: layout.MDP,
    EgoVehicle: layout.EXECUTOR,
    Obstacle: layout.OBSTACLE,
}
"""The classes that the kernel knows, exactly: a subclass may behave otherwise."""

CONSTANTS: dict[str, float] = {
    "ACC_MAX": layout.ACC_MAX,
    "POLITENESS": 0.0,
    "LANE_CHANGE_MIN_ACC_GAIN": layout.LANE_CHANGE_MIN_ACC_GAIN,
    "LANE_CHANGE_MAX_BRAKING_IMPOSED": layout.LANE_CHANGE_MAX_BRAKING_IMPOSED,
    "LANE_CHANGE_DELAY": layout.LANE_CHANGE_DELAY,
    "MAX_SPEED": layout.MAX_SPEED,
    "MIN_SPEED": layout.MIN_SPEED,
    "KP_A": layout.KP_A,
    "KP_HEADING": layout.KP_HEADING,
    "KP_LATERAL": layout.KP_LATERAL,
    "TAU_PURSUIT": layout.TAU_PURSUIT,
    "MAX_STEERING_ANGLE": layout.MAX_STEERING_ANGLE,
    "WIDTH": layout.VEHICLE_WIDTH_M,
}
"""What is compiled in; a vehicle that has another value, of its own or of its class, is upstream's."""


def manners_of(vehicle: IDMVehicle) -> list[float]:
    """A row of `Spawn.manners` that describes the vehicle."""
    hard, sway = getattr(vehicle, "hard", TrafficVehicle.hard), getattr(vehicle, "sway", TrafficVehicle.sway)
    idm = (vehicle.COMFORT_ACC_MAX, -vehicle.COMFORT_ACC_MIN, vehicle.DISTANCE_WANTED, vehicle.TIME_WANTED)
    return [*idm, vehicle.LENGTH, *hard, *sway]


NO_VIEW = View(
    np.zeros((0, 0, len(ROW_COLUMNS)), np.float32), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(0, np.int64), 0.0, 0.0
)
"""Publishes nothing."""


def new_ego(
    scenes: int,
    speeds: NDArray[np.float64],
    freezes: bool = False,
    pieces: NDArray[np.float64] | None = None,
    gates: NDArray[np.float64] | None = None,
    floor: float = 0.0,
    ceiling: float = 0.0,
) -> Ego:
    """Egos at rest; see `Ego` for the fields."""
    return Ego(
        meta=np.zeros(scenes, np.int64),
        speed_goal=np.full(scenes, np.nan),
        speed_cap=np.full(scenes, np.inf),
        style=np.ones(scenes, np.int64),
        target_speed=np.zeros(scenes),
        target_lane=np.zeros(scenes, np.int64),
        previous_lane=np.full(scenes, -1, np.int64),
        accel=np.zeros(scenes),
        crashed=np.zeros(scenes, np.bool_),
        ticks=np.zeros(scenes, np.int64),
        speeds=speeds,
        # Exactly these types: with an int for a float numba would compile anew, in the middle of a drive.
        pieces=np.zeros((1, 7)) if pieces is None else np.ascontiguousarray(pieces, np.float64),
        gates=np.zeros((1, 4)) if gates is None else np.ascontiguousarray(gates, np.float64),
        floor=float(floor),
        ceiling=float(ceiling),
        freezes=freezes,
    )


class Bridge:
    """One road of highway-env as arrays, S = 1: `read`, let the kernel advance `f`, `g` and `ego`, `write`."""

    f: NDArray[np.float64]
    g: NDArray[np.int64]
    ego: Ego
    scratch: Scratch
    kinds: list[int]

    def __init__(self) -> None:
        self._network: Any = None
        self._connected = False
        self._everything: list[Any] = []

    def read(self, road: Road) -> None:
        """Take the state of every vehicle and object. Raises UnsupportedError for what the kernel does not know.

        Controls are not read: whoever drives sets them anew at every tick, and whoever has crashed has none. But of an
        executor's car that is not the first they are: the kernel has set-points for the first alone.
        """
        cars = road.vehicles
        everything = cars + road.objects
        if not self._knows(road) or everything != self._everything:
            self._meet(road, everything)
        if road.record_history:
            raise UnsupportedError("recorded trajectories (show_trajectories)")
        if any(getattr(v, "route", None) for v in cars):
            raise UnsupportedError("planned routes")
        n = len(everything)
        floats, ints, number = self.f[0], self.g[0], self.tables.number
        floats[layout.X : layout.Y + 1] = np.concatenate([v.position for v in everything]).reshape(n, 2).T
        floats[layout.ANGLE] = [v.heading for v in everything]
        floats[layout.SPEED] = [v.speed for v in everything]
        floats[layout.TARGET_SPEED] = [getattr(v, "target_speed", 0.0) for v in everything]
        floats[layout.DELTA] = [getattr(v, "DELTA", 1.0) for v in everything]
        floats[layout.TIMER] = [getattr(v, "timer", 0.0) for v in everything]
        floats[layout.AGE] = [getattr(v, "age", 0.0) for v in everything]
        ints[layout.LANE] = [number[v.lane_index] for v in everything]
        ints[layout.TARGET_LANE] = [number[getattr(v, "target_lane_index", v.lane_index)] for v in everything]
        ints[layout.CRASHED] = [v.crashed for v in everything]
        ints[layout.CHANGES] = [getattr(v, "enable_lane_change", False) for v in everything]
        ints[layout.CHECKS] = [v.check_collisions for v in everything]
        ints[layout.PUSHED] = 0
        for i, v in enumerate(cars):
            if v.impact is not None:
                floats[layout.PUSH_X : layout.PUSH_Y + 1, i] = v.impact
                ints[layout.PUSHED, i] = 1
        first, ego = cars[0], self.ego
        if self.kinds[0] == layout.EXECUTOR:
            ints[layout.TARGET_LANE, 0] = 0  # its lanes are the scenario's
            ego.meta[0], ego.speed_goal[0], ego.accel[0] = first.meta, first.speed_goal, first.acceleration
            ego.target_lane[0], ego.previous_lane[0] = first.target_lane, first.previous_lane
            ego.speed_cap[0], ego.style[0] = first.speed_cap, first.style
        elif self.kinds[0] == layout.MDP:
            ints[layout.SPEED_INDEX, 0] = first.speed_index
            ego.speeds[:] = first.target_speeds
        self.ego.target_speed[0] = first.target_speed
        for i in self._others:
            floats[layout.STEERING, i], floats[layout.ACCEL, i] = (
                cars[i].action["steering"],
                cars[i].action["acceleration"],
            )
        self._before = ints[_MARKS].copy()

    def write(self, road: Road) -> None:
        """Give the vehicles and objects the state that `read` took and the kernel advanced."""
        rows, ints = self.f[0].tolist(), self.g[0]
        for v, kind, x, y, heading, speed, timer, steering, accel, age in zip(
            road.vehicles,
            self.kinds,
            rows[layout.X],
            rows[layout.Y],
            rows[layout.ANGLE],
            rows[layout.SPEED],
            rows[layout.TIMER],
            rows[layout.STEERING],
            rows[layout.ACCEL],
            rows[layout.AGE],
            strict=False,
        ):
            position = v.position
            position[0] = x
            position[1] = y
            v.heading = heading
            v.speed = speed
            v.action = {"steering": steering, "acceleration": accel}
            if kind <= layout.TRAFFIC:
                v.timer = timer
            if kind == layout.TRAFFIC:
                v.age = age
        indices, lanes, cars = self.tables.indices, self.tables.lanes, len(road.vehicles)
        for i in np.flatnonzero((ints[_MARKS] != self._before).any(axis=0) | (ints[layout.PUSHED] != 0)):
            v = self._everything[i]
            v.crashed = bool(ints[layout.CRASHED, i])
            if i >= cars:
                continue
            k = ints[layout.LANE, i]
            v.lane_index, v.lane = indices[k], lanes[k]
            push = self.f[0, layout.PUSH_X : layout.PUSH_Y + 1, i].copy()
            v.impact = push if ints[layout.PUSHED, i] else None
            if self.kinds[i] != layout.EXECUTOR:
                v.target_lane_index = indices[ints[layout.TARGET_LANE, i]]
        first = road.vehicles[0]
        if self.kinds[0] == layout.EXECUTOR:
            first.previous_lane, first.acceleration = int(self.ego.previous_lane[0]), float(self.ego.accel[0])
        elif self.kinds[0] == layout.MDP:
            first.speed_index, first.target_speed = int(ints[layout.SPEED_INDEX, 0]), rows[layout.TARGET_SPEED][0]

    def _knows(self, road: Road) -> bool:
        return self._network is road.network and self._connected == road.neighbour_vehicles_connected_lanes

    def _meet(self, road: Road, everything: list[Any]) -> None:
        """What stays as it is while the same vehicles are on the same road."""
        self._everything = []
        if not self._knows(road):
            self.tables = tables.read(road.network, road.neighbour_vehicles_connected_lanes)
            self._network, self._connected = road.network, road.neighbour_vehicles_connected_lanes
        cars, n = len(road.vehicles), len(everything)
        if not cars:
            raise UnsupportedError("an empty road")
        kinds = [KINDS.get(type(v), -1) for v in everything]
        for i, (v, kind) in enumerate(zip(everything, kinds, strict=True)):
            if kind < 0 or (kind == layout.OBSTACLE) != (i >= cars):
                raise UnsupportedError(f"{type(v).__name__} here")
            if not (v.solid and v.collidable):
                raise UnsupportedError("things that one can drive through")
            if kind in (layout.IDM, layout.MDP) and v.LENGTH != CAR_LENGTH_M:
                raise UnsupportedError(f"{type(v).__name__} of another length")
            for name, value in CONSTANTS.items():
                if getattr(v, name, value) != value:
                    raise UnsupportedError(f"{type(v).__name__} with another {name}")
        self.f, self.g = np.zeros((1, layout.FLOATS, n)), np.zeros((1, layout.INTS, n), np.int64)
        self.f[0, layout.CAR_LENGTH], self.f[0, layout.CAR_WIDTH] = (
            [v.LENGTH for v in everything],
            layout.VEHICLE_WIDTH_M,
        )
        self.g[0, layout.KIND] = kinds
        for i, (v, kind) in enumerate(zip(everything, kinds, strict=True)):
            if layout.ABSENT < kind <= layout.TRAFFIC:
                layout.set_manners(self.f[0], i, manners_of(v))
        self.scratch = layout.new_scratch(n, len(self.tables.lanes))
        first = everything[0]
        if kinds[0] == layout.EXECUTOR:
            bounds = first.scenario.ego
            self.ego = new_ego(
                1, _NO_SPEEDS, False, first.pieces, first.gates, bounds.speed_floor_mps, bounds.speed_ceiling_mps
            )
        else:
            self.ego = new_ego(1, first.target_speeds.astype(np.float64) if kinds[0] == layout.MDP else _NO_SPEEDS)
        self._others = [i for i, kind in enumerate(kinds) if i and kind == layout.EXECUTOR]
        self.kinds, self._everything = kinds, everything


_NO_SPEEDS = np.array([0.0, 1.0])
_MARKS = [layout.LANE, layout.TARGET_LANE, layout.CRASHED, layout.PUSHED]
