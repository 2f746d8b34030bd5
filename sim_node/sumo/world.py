"""Many scenes of a scenario in SUMO's traffic, in the form that evaluation drives; the ticks of `sim_node.sumo.env`.

Axes: S scenes, V vehicles, L lanes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from schemas.driving.episode import Ending, ending
from schemas.driving.road import DT_S, HZ, LANE
from sim_node.engine.batched import Batched
from sim_node.engine.kernel import layout, tick
from sim_node.scenarios import Scenario
from sim_node.scenarios.scenario import Spawn
from sim_node.sumo.traffic import Traffic

CHANGES_MPS = 0.3
"""An ego of SUMO's that moves sideways faster than this changes lanes."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class SumoWorld(Batched):
    """`Batched` scenes whose other cars SUMO drives; they end for good once their episode is over."""

    def __init__(
        self, scenario: Scenario, scenes: int, first_seed: int, *, ego_model: str | None = None, actuator: bool = False
    ) -> None:
        """Scene k is that of seed `first_seed` + k; all are to be loaded before the first tick.

        ego_model: SUMO's car-following model of the egos, which then drive themselves; None: they take actions.
        actuator: as `Batched` has it. Raises `ConfigError` where SUMO is not installed.
        """
        self._first_seed, self._ego_model = first_seed, ego_model
        self._traffic = Traffic(scenario, HZ, scenes)
        self._spawns: dict[int, Spawn] = {}
        self._begun = False
        super().__init__(scenario, scenes, 0, actuator=actuator)
        self._over = np.zeros(scenes, np.bool_)

    def load(self, scene: int, spawn: Spawn) -> None:
        """These vehicles are in one scene, at tick 0."""
        super().load(scene, spawn)
        self._spawns[scene] = spawn
        self._g[scene, layout.KIND, 1 : self.vehicles] = layout.ABSENT

    def begin(self) -> None:
        """All scenes are loaded."""
        self._begun = True
        self._traffic.load([self._spawns[s] for s in range(self.scenes)], self._first_seed, self._ego_model)
        self._show()

    def tick(self, meta: Ints, speed_goal: Floats, speed_cap: Floats | float = math.inf, style: Ints | int = 1) -> None:
        """As `Batched.tick`; an ego of SUMO's takes no actions."""
        traffic, f = self._traffic, self._f
        self._g[:, layout.KIND, 1 : self.vehicles] = layout.ABSENT
        if self._ego_model is None:
            super().tick(meta, speed_goal, speed_cap, style)
            driven = ~(self._over | self.crashed)
            traffic.tick(f[:, layout.X, 0], f[:, layout.Y, 0], f[:, layout.ANGLE, 0], driven)
        else:
            before = self.target_lane.copy()
            nowhere = np.zeros(self.scenes)
            traffic.tick(nowhere, nowhere, nowhere, np.zeros(self.scenes, np.bool_))
            self._follow(before)
        self._show()
        over = ending(self.crashed, self.rows[:, 0], self.scenario.goal) != Ending.NONE
        traffic.retire(over & ~self._over)
        self._over |= over

    def _follow(self, before: Ints) -> None:
        """The egos are where SUMO has driven them. before (S,): their lanes."""
        traffic, f = self._traffic, self._f
        on = traffic.here[:, 0] & ~self._over
        self.accel[on] = (traffic.speed[on, 0] - f[on, layout.SPEED, 0]) / DT_S
        for column, now in self._states():
            f[on, column, 0] = now[on, 0]
        self.target_speed[on] = traffic.speed[on, 0]
        self.ticks[~self._over] += 1
        self._show()
        self.target_lane[on] = self.rows[on, 0, LANE].astype(np.int64)
        sideways = np.abs(traffic.speed[:, 0] * np.sin(traffic.heading[:, 0])) > CHANGES_MPS
        changed = np.where(before != self.target_lane, before, np.maximum(self.previous_lane, 0))
        self.previous_lane[on] = np.where(sideways, changed, -1)[on]

    def _states(self) -> list[tuple[int, Floats]]:
        t = self._traffic
        return [(layout.X, t.x), (layout.Y, t.y), (layout.ANGLE, t.heading), (layout.SPEED, t.speed)]

    def _show(self) -> None:
        """Put the other cars where SUMO has them, look for contacts, and publish the rows."""
        f, g, n, here = self._f, self._g, self.vehicles, self._traffic.here[:, 1:]
        for column, now in self._states():
            f[:, column, 1:n] = np.where(here, now[:, 1:], layout.ABSENT_X_M if column == layout.X else 0.0)
        f[:, layout.CAR_LENGTH, 1:n] = self._traffic.length[:, 1:]
        g[:, layout.KIND, 1:n] = np.where(here, layout.OBSTACLE, layout.ABSENT)
        tick.show(self._calls, self._scratch, f, g, self._ego, self._view)

    def close(self) -> None:
        """End SUMO's world."""
        self._traffic.close()
