"""The other cars: highway-env's IDM/MOBIL driver, kept from driving backwards."""

from __future__ import annotations

from highway_env.vehicle.behavior import IDMVehicle

STEERS_MPS = 0.1
"""Slower than this a car keeps its heading: upstream's steering divides by the speed and would turn it on the spot."""


class TrafficVehicle(IDMVehicle):  # type: ignore[misc]
    """Upstream's driver; where its gap is gone it stands still instead of reversing into whoever is behind."""

    def step(self, dt: float) -> None:
        """Move for `dt` s; the last braking ends in a standstill."""
        if not self.crashed:
            self.action["acceleration"] = max(self.action["acceleration"], -self.speed / dt)
            if self.speed < STEERS_MPS:
                self.action["steering"] = 0.0
        super().step(dt)
