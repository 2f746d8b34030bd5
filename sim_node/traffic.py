"""The other cars: highway-env's IDM/MOBIL driver, kept from driving backwards, and varied as a scenario has it."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.vehicle.behavior import IDMVehicle
from numpy.typing import NDArray

from schemas.driving.measures import CAR_LENGTH_M

STEERS_MPS = 0.1
"""Slower than this a car keeps its heading: upstream's steering divides by the speed and would turn it on the spot."""


def longer_m(one_m: float, other_m: float) -> float:
    """How much farther apart two centres are, bumper to bumper as near, where cars are longer than usual. Compiles."""
    return 0.5 * (max(one_m - CAR_LENGTH_M, 0.0) + max(other_m - CAR_LENGTH_M, 0.0))


class TrafficVehicle(IDMVehicle):  # type: ignore[misc]
    """Upstream's driver; where its gap is gone it stands still instead of reversing into whoever is behind."""

    age = 0.0
    """Seconds it has driven."""
    position: NDArray[np.float64]
    hard = (-1.0, -1.0, 0.0)
    """From when to when it brakes hard, and how hard [m/s2]."""
    sway = (0.0, 0.0, 0.0)
    """How far to either side [m], rad/s, rad."""

    def behave(self, row: Any) -> None:
        """Take on the manners of a row of `Spawn.manners`."""
        accel, brake, gap, time, length, *rest = (float(value) for value in row)
        self.COMFORT_ACC_MAX, self.COMFORT_ACC_MIN, self.DISTANCE_WANTED, self.TIME_WANTED = accel, -brake, gap, time
        self.LENGTH = length
        self.diagonal = np.sqrt(self.LENGTH**2 + self.WIDTH**2)
        self.hard = (rest[0], rest[1], rest[2])
        self.sway = (rest[3], rest[4], rest[5])

    def desired_gap(self, ego_vehicle: Any, front_vehicle: Any = None, projected: bool = True) -> float:
        """Upstream's, which is from centre to centre, with more where a vehicle is longer than a car."""
        usual = self.DISTANCE_WANTED
        self.DISTANCE_WANTED = usual + longer_m(ego_vehicle.LENGTH, front_vehicle.LENGTH)
        gap = super().desired_gap(ego_vehicle, front_vehicle, projected)
        self.DISTANCE_WANTED = usual
        return float(gap)

    def steering_control(self, target_lane_index: Any) -> float:
        """Upstream's, from a centre line that sways."""
        far, rate, phase = self.sway
        if far == 0.0:
            return float(super().steering_control(target_lane_index))
        here = self.position
        self.position = here - np.array([0.0, far * float(np.sin(rate * self.age + phase))])
        steering = float(super().steering_control(target_lane_index))
        self.position = here
        return steering

    def step(self, dt: float) -> None:
        """Move for `dt` s; the last braking ends in a standstill."""
        if not self.crashed:
            begin, end, how = self.hard
            if begin <= self.age < end:
                self.action["acceleration"] = min(self.action["acceleration"], -how)
            self.action["acceleration"] = max(self.action["acceleration"], -self.speed / dt)
            if self.speed < STEERS_MPS:
                self.action["steering"] = 0.0
        self.age += dt
        super().step(dt)
