"""The tracks that the fast node keeps from tick to tick; what they are is `schemas.driving.tracks`."""

from __future__ import annotations

from typing import Any

from schemas.driving.road import ID, NOBODY
from schemas.driving.tracks import COLUMNS, N_NOISE, REMEMBER_S, SIGMA, SPARE, follow
from schemas.wire.messages import Observation


class Tracks:
    """The tracks of one ego's world: what a node keeps from tick to tick."""

    def __init__(self) -> None:
        self._epoch: int | None = None
        self._tick, self._lanes = 0, 0
        self._tracks: list[list[float]] = []
        self._noise = [0.0] * N_NOISE

    @property
    def noise(self) -> tuple[float, float, float, float]:
        """Standard deviations that the sensor seems to have: x, y [m], vx, vy [m/s]; 0 for what is exact."""
        x, y, vx, vy = self._noise[SIGMA : SIGMA + 4]
        return x, y, vx, vy

    def follow(self, observation: Observation, seen: Any, lanes: Any) -> list[list[float]]:
        """(T, COLUMNS): the ego and the cars that are seen or missed, to read at once and not to change. An observation
        of the same tick again, or of an earlier one, begins anew, as does one of another epoch or road.

        seen: (V, 9) rows of the observation; lanes: (L, 8) as `lane_table`.
        """
        ticks = observation.tick - self._tick
        another = observation.epoch != self._epoch or len(lanes) != self._lanes
        if another or ticks <= 0 or ticks > REMEMBER_S * observation.hz:
            self._epoch, self._tracks, self._noise = observation.epoch, [], [0.0] * N_NOISE
            ticks = 1
        self._tick, self._lanes = observation.tick, len(lanes)
        while len(self._tracks) < len(seen) + SPARE:
            self._tracks.append([float(NOBODY)] + [0.0] * (COLUMNS - 1))
        follow(self._tracks, self._noise, seen, lanes, observation.sight_m, ticks / observation.hz)
        return [t for t in self._tracks if t[ID] != NOBODY]
