"""The tracks of many scenes at once: what `schemas.driving.tracks` does for a node, compiled. Axes: S scenes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.driving.features import Array
from schemas.driving.road import DT_S, ID, NOBODY
from schemas.driving.tracks import COLUMNS, N_NOISE, follow
from schemas.runtime.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Sense = Callable[[int, Array], Array]
"""A scene's index and its rows (V, 9), absent ones included, to what its ego's sensors report, in the same form."""


def _follow_all(tracks: Any, noise: Any, seen: Any, lanes: Any, sight: float, age: Any, ticks: Any) -> None:
    """tracks (S, V, C), noise (S, N), seen (S, V, 9), lanes (S, L, 8); age, ticks (S,): of the scenes, now and when it
    was looked at them last; where both are the same, nothing is done."""
    for s in range(len(tracks)):
        if age[s] == ticks[s]:
            continue
        if age[s] == 0 or ticks[s] < 0:
            tracks[s] = 0.0
            tracks[s, :, ID] = NOBODY
            noise[s] = 0.0
        follow(tracks[s], noise[s], seen[s], lanes[s], sight, (age[s] - ticks[s]) * DT_S)
        ticks[s] = age[s]


_follow = compiled(_follow_all)


class FleetTracks:
    """One `Tracks` per scene."""

    rows: Floats
    """(S, V, C) what every ego knows, in the columns of `schemas.driving.tracks`."""

    def __init__(self, rows: Array, sense: Sense | None) -> None:
        """rows: (S, V, 9) of the world; sense: see `Sense`, None: everything is seen as it is."""
        self._sense = sense
        self._seen = rows.astype(np.float64)  # the node computes with Python's floats: here the same numbers
        self.rows, self._noise = np.zeros((*rows.shape[:2], COLUMNS)), np.zeros((len(rows), N_NOISE))
        self._ticks = np.full(len(rows), -1)

    def follow(self, rows: Array, ticks: Ints, lanes: Floats, sight_m: float) -> Bools:
        """Take in the rows of the world, where it has gone on since the last call: (S,) these. ticks (S,): of its
        episodes so far."""
        fresh: Bools = ticks != self._ticks
        self._seen[:] = rows
        if self._sense is not None:
            for scene in np.flatnonzero(fresh):
                self._seen[scene] = self._sense(int(scene), rows[scene])
        _follow(self.rows, self._noise, self._seen, lanes, sight_m, ticks, self._ticks)
        return fresh

    def become(self, other: FleetTracks, which: Ints) -> None:
        """Go on from the tracks of scenes `which` (S,) of another fleet."""
        for name in ("rows", "_noise", "_ticks"):
            getattr(self, name)[:] = getattr(other, name)[which]

    def forget(self, which: Bools) -> None:
        """These scenes begin anew."""
        self._ticks[which] = -1
