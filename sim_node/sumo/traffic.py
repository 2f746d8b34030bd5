"""The traffic that SUMO drives, in this process. One at a time: SUMO's library has one world per process.

Axes: S scenes, V vehicles, the ego first. Positions are centres in the road frame, SI units.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.driving.measures import CAR_LENGTH_M
from schemas.runtime.errors import ConfigError
from sim_node.scenarios import Scenario
from sim_node.scenarios.manners import CAR_LENGTH
from sim_node.scenarios.scenario import Spawn
from sim_node.sumo.network import APART_M, MODELS, lanes_count, network, place_y, vehicles

CHANGE_S = 3.0
"""A lane change of SUMO's takes so long; without a duration it would be a jump."""
ANYWHERE = 2
"""Of `moveToXY`: the exact place, whatever the route says."""
MOVES_M, STEEPEST = 0.02, 0.3
"""A front that moves less in a tick shows no direction; none is steeper than this [m/m]."""
SEEDS_MAX = 2**31
"""SUMO's own seeds are smaller than this."""
DRIVERS = 7
"""Beside a seed: the generator that draws the cars' drivers."""

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def library() -> Any:
    """SUMO in process. Raises `ConfigError` where it is not installed."""
    try:
        import libsumo
    except ImportError:
        raise ConfigError("SUMO is missing: pip install 'fastslow[sumo]'") from None
    return libsumo


class Traffic:
    """Scenes of a scenario in SUMO, tick by tick. What a scene does depends on its seed, not on the others."""

    def __init__(self, scenario: Scenario, hz: int, scenes: int = 1) -> None:
        """Raises `ConfigError` where SUMO is not installed, ValueError for manners that its drivers do not know."""
        manners = scenario.manners
        if manners.idm_spread or manners.hard_brakers or manners.sway_m:
            raise ValueError("SUMO's drivers have manners of their own: of --traffic they know trucks and narrow")
        self._sumo = library()
        self._scenario, self._hz, self._scenes = scenario, hz, scenes
        self._network = network(scenario, scenes)
        self._lanes = lanes_count(scenario)
        size = (scenes, scenario.vehicles_max)
        self.x, self.y, self.heading, self.speed = (np.zeros(size) for _ in range(4))
        """(S, V); of who is not `here` as it was last."""
        self.length, self._way = np.full(size, CAR_LENGTH_M), np.ones(size)
        self.here = np.zeros(size, np.bool_)
        self._front = np.full((*size, 2), np.nan)
        self._index = {f"{s}.{i}": s * size[1] + i for s in range(scenes) for i in range(size[1])}
        self._egos = [f"{s}.0" for s in range(scenes)]
        self._borrows = any(plan.direction < 0 for plan in scenario.lanes)

    def load(self, spawns: Sequence[Spawn], first_seed: int, ego_model: str | None = None) -> None:
        """The cars of a scene each, at time 0; the scenes' seeds are `first_seed` and those that follow it.

        A seed decides which driver each car has, and all that SUMO draws. ego_model: of the egos, where SUMO is to
        drive them. Raises ValueError for seeds that cannot be in one world.
        """
        number = self._number(first_seed, len(spawns))
        models, known = [], list(MODELS)
        self.length[:], self._way[:], self._front[:] = CAR_LENGTH_M, 1.0, np.nan
        for s, spawn in enumerate(spawns):
            n = len(spawn.x)
            drawn = np.random.default_rng([first_seed + s, DRIVERS]).integers(0, len(known), n)
            models.append([ego_model or known[0], *(known[k] for k in drawn[1:])])
            self.length[s, 1:n] = spawn.manners[1:, CAR_LENGTH]
            self._way[s, :n] = spawn.direction
        with tempfile.TemporaryDirectory(prefix="fastslow-sumo-") as folder:
            self._put_on_the_road(Path(folder), vehicles(self._scenario, spawns, models), number)
        ceiling = self._scenario.ego.speed_ceiling_mps
        for s, spawn in enumerate(spawns):
            for i in range(len(spawn.x)):  # who starts faster than it likes to drive slows down from there
                wish = float(spawn.target_speed[i]) if i else ceiling
                self._sumo.vehicle.setMaxSpeed(f"{s}.{i}", wish)
        self._read()

    def _number(self, first_seed: int, scenes: int) -> int:
        """SUMO's seed of the first scene: each lane draws from a generator of its own, and these have that number and
        those after it.

        What SUMO draws is the same again after `SEEDS_MAX // lanes` seeds, where its numbers end: no world goes on past
        that, or a scene there would not be what it is alone. Raises ValueError for one that would.
        """
        fit = SEEDS_MAX // self._lanes
        if (place := first_seed % fit) + scenes > fit:
            start = first_seed - place + fit
            seeds = f"{first_seed}..{first_seed + scenes - 1}"
            raise ValueError(
                f"seeds {seeds} are not in one world of SUMO's on {self._scenario.name}: "
                f"let {start - 1} be the largest, or begin with {start}"
            )
        return place * self._lanes

    def _put_on_the_road(self, folder: Path, cars: str, number: int) -> None:
        """SUMO's world anew, with these vehicles; its files are in `folder` for so long."""
        files = folder / "road.net.xml", folder / "cars.rou.xml"
        for file, text in zip(files, (self._network, cars), strict=True):
            file.write_text(text)
        words = [
            *("-n", str(files[0]), "-r", str(files[1])),
            *("--seed", str(number), "--thread-rngs", str(self._lanes * self._scenes)),
            *("--step-length", f"{1.0 / self._hz:.7f}", "--lanechange.duration", f"{CHANGE_S}"),
            *("--collision.action", "none", "--time-to-teleport", "-1", "--xml-validation", "never"),
            *("--no-step-log", "true", "--no-warnings", "true", "--duration-log.disable", "true"),
        ]
        sumo = self._sumo
        if sumo.simulation.isLoaded():
            sumo.load(words)
        else:
            sumo.start(["sumo", *words])
        sumo.simulationStep()  # puts the cars on the road; nobody moves yet

    def tick(self, x: Floats, y: Floats, heading: Floats, driven: Bools) -> None:
        """Everybody drives on for a tick, seeing where the egos were; then those that are `driven` (S,) by us are where
        x, y, heading (S,) say."""
        vehicle = self._sumo.vehicle
        half = 0.5 * CAR_LENGTH_M
        for s in np.flatnonzero(driven & self.here[:, 0]):
            ego, angle = self._egos[s], float(heading[s])
            front_x, front_y = float(x[s]) + half * math.cos(angle), float(y[s]) + half * math.sin(angle)
            vehicle.moveToXY(ego, "", -1, front_x, place_y(s, front_y), 90.0 + math.degrees(angle), ANYWHERE)
            if self._borrows and float(y[s]) < 0.5 * self._scenario.lanes[0].width_m:
                # SUMO would take it for one that drives away with this speed: for a standing one they brake in time.
                vehicle.setPreviousSpeed(ego, 0.0)
        self._sumo.simulationStep()
        self._read()

    def retire(self, scenes: Bools) -> None:
        """These (S,) are over: their cars leave the road."""
        for s in np.flatnonzero(scenes):
            for i in np.flatnonzero(self.here[s]):
                self._sumo.vehicle.remove(f"{s}.{i}")
            self.here[s] = False

    def _read(self) -> None:
        """SUMO shifts a car that changes lanes and does not turn it. Here its heading is the way that it went in the
        last tick, and its centre as far aside as its front."""
        vehicle, shape = self._sumo.vehicle, self.x.shape
        names = vehicle.getIDList()
        at = np.array([self._index[name] for name in names], np.int64)
        front = np.array([vehicle.getPosition(name) for name in names], np.float64).reshape(-1, 2)
        self.here[:] = False
        s, i = np.unravel_index(at, shape)
        self.here[s, i] = True
        self.speed[s, i] = [vehicle.getSpeed(name) for name in names]
        front[:, 1] = -front[:, 1] - APART_M * s
        moved, way = front - self._front[s, i], self._way[s, i]
        with np.errstate(invalid="ignore", divide="ignore"):
            aside = np.clip(moved[:, 1] / np.abs(moved[:, 0]), -STEEPEST, STEEPEST)
        aside = np.arctan(np.where(np.abs(moved[:, 0]) > MOVES_M, aside, 0.0))  # false for nan, at the start
        heading = np.where(way > 0, aside, np.pi - aside)
        self._front[s, i], self.heading[s, i] = front, heading
        self.x[s, i] = front[:, 0] - 0.5 * self.length[s, i] * np.cos(heading)
        self.y[s, i] = front[:, 1]

    def close(self) -> None:
        """End SUMO's world."""
        if self._sumo.simulation.isLoaded():
            self._sumo.close()
