"""highway-env's Kinematics observation without pandas: the same values."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from highway_env.envs.common.observation import KinematicObservation
from highway_env.road.lane import AbstractLane, StraightLane
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from schemas.runtime.compiled import compiled
from sim_node.engine.kernel.layout import Calls, new_calls
from sim_node.engine.loops import COS, SIN, dot, one

COLUMNS = ("presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h")
"""The features that are known here; with others upstream's own code runs."""
PRESENCE, X, Y, VX, VY, HEADING, COS_H, SIN_H = range(len(COLUMNS))


def _fill(
    calls: Calls,
    places: Any,
    heading: Any,
    speed: Any,
    ego: int,
    cars: int,
    start: Any,
    direction: Any,
    sight: float,
    behind: float,
    see_behind: bool,
    ordered: bool,
    absolute: bool,
    ranges: Any,
    clip: bool,
    key: Any,
    chosen: Any,
    out: Any,
) -> None:
    """Road.close_objects_to and KinematicObservation.observe: rows of `COLUMNS` into `out`."""
    wanted = out.shape[0] - 1
    dx, dy = direction
    x, y = places[ego]
    own = dot(calls.loops, calls.args, calls.box, x - start[0], y - start[1], dx, dy)
    n = 0
    for i in range(places.shape[0]):
        ox, oy = places[i, 0] - x, places[i, 1] - y
        if i == ego or not math.sqrt(dot(calls.loops, calls.args, calls.box, ox, oy, ox, oy)) < sight:
            continue
        along = dot(calls.loops, calls.args, calls.box, places[i, 0] - start[0], places[i, 1] - start[1], dx, dy)
        away = along - own
        if not (away > behind or (see_behind and i < cars)):
            continue
        at = n
        if ordered:
            while at > 0 and key[at - 1] > abs(away):
                at -= 1
        if at >= wanted:
            continue
        n = min(n + 1, wanted)
        for k in range(n - 1, at, -1):
            key[k], chosen[k] = key[k - 1], chosen[k - 1]
        key[at], chosen[at] = abs(away), i
    for row in range(n + 1):
        i = ego if row == 0 else chosen[row - 1]
        c = one(calls.loops, COS, calls.args, calls.box, heading[i])
        s = one(calls.loops, SIN, calls.args, calls.box, heading[i])
        out[row, PRESENCE], out[row, X], out[row, Y] = 1.0, places[i, 0], places[i, 1]
        out[row, VX], out[row, VY] = speed[i] * c, speed[i] * s
        out[row, HEADING], out[row, COS_H], out[row, SIN_H] = heading[i], c, s
    if not absolute:
        for row in range(1, n + 1):
            for k in (X, Y, VX, VY):
                out[row, k] -= out[0, k]
    for k in range(len(COLUMNS)):
        low, high = ranges[k, 0], ranges[k, 1]
        if not np.isnan(low):
            for row in range(n + 1):
                scaled = -1 + (out[row, k] - low) * 2 / (high - low)
                out[row, k] = min(max(scaled, -1.0), 1.0) if clip else scaled


_kinematics = compiled(_fill, inline=True, error_model="numpy", _nrt=False)
_CALLS = new_calls()


class ArrayKinematics(KinematicObservation):  # type: ignore[misc]
    """`KinematicObservation` from arrays; what it does not know (other features, other lanes) upstream observes."""

    features_range: dict[str, Any] | None

    def observe(self) -> NDArray[np.float32]:
        """(vehicles_count, features) float32, as upstream's."""
        road, ego = self.env.road, self.observer_vehicle
        # Upstream's rows of objects have no heading.
        unknown = set(self.features) - set(COLUMNS[:5] if road and road.objects else COLUMNS)
        if not road or unknown or self.vehicles_count < 2 or not isinstance(ego.lane, StraightLane):
            return np.asarray(super().observe())
        cars = road.vehicles
        shown = cars + road.objects if self.include_obstacles else cars
        n = len(shown)
        # Objects have no speed in upstream's rows, whatever theirs is.
        speed = [v.speed for v in cars] + [0.0] * (n - len(cars))
        out = np.zeros((self.vehicles_count, len(COLUMNS)))
        _kinematics(
            _CALLS,
            np.concatenate([v.position for v in shown]).reshape(n, 2),
            np.array([v.heading for v in shown], np.float64),
            np.array(speed, np.float64),
            cars.index(ego),
            len(cars),
            ego.lane.start.astype(np.float64),
            ego.lane.direction,
            self.env.PERCEPTION_DISTANCE,
            -2.0 * ego.LENGTH,
            bool(self.see_behind),
            self.order == "sorted",
            bool(self.absolute),
            self._ranges(),
            bool(self.clip),
            np.empty(n),
            np.empty(n, np.int64),
            out,
        )
        seen = out[:, [COLUMNS.index(name) for name in self.features]]
        if self.order == "shuffled":
            self.env.np_random.shuffle(seen[1:])
        return np.asarray(seen.astype(np.float32))

    def _ranges(self) -> NDArray[np.float64]:
        """(8, 2) what maps to -1 and 1, nan where nothing does; chosen at the first observation, as upstream."""
        table = np.full((len(COLUMNS), 2), np.nan)
        if self.normalize:
            if not self.features_range:
                width = AbstractLane.DEFAULT_WIDTH * len(
                    self.env.road.network.all_side_lanes(self.observer_vehicle.lane_index)
                )
                far, fast = 5.0 * Vehicle.MAX_SPEED, 2 * Vehicle.MAX_SPEED
                self.features_range = {"x": [-far, far], "y": [-width, width], "vx": [-fast, fast], "vy": [-fast, fast]}
            for name, bounds in self.features_range.items():
                if name in self.features:
                    table[COLUMNS.index(name)] = bounds[0], bounds[1]
        return table
