"""Decisions of one second in many scenes at once, behind the mask: the world comes in as an object, never an import.

Axes: S scenes, V vehicles.
"""

from __future__ import annotations

import importlib.util
from typing import Any, Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from fast_node import coordination, mask
from fast_node.features import Array, policy_input
from schemas import measures
from schemas.messages import MetaAction

DECISION_TICKS = 15
HORIZON = 45
"""Decisions until an episode is truncated."""



def _compiled_mask() -> Any:
    """`close_actions` compiled from the very source that drives: a second copy of the module, which stays plain."""
    spec = importlib.util.spec_from_file_location("fast_node._compiled_mask", mask.__file__)
    assert spec is not None
    assert spec.loader is not None
    copy = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(copy)
    for name in ("gap_m", "rss_same_direction_m", "rss_opposite_m"):
        setattr(copy, name, numba.njit(getattr(measures, name)))
    for name in ("allowed_speed", "pass_time_s", "neighbours", "entry", "passing"):
        setattr(copy, name, numba.njit(getattr(copy, name)))
    return numba.njit(copy.close_actions)


_close = _compiled_mask()
_wished_lane = numba.njit(coordination.wished_lane)


@numba.njit  # type: ignore[untyped-decorator]
def _close_all(
    rows: Any, lanes: Any, target_speed: Any, target_lane: Any, previous: Any, rule: Any, vehicle: Any
) -> None:
    for s in range(rows.shape[0]):
        _close(rows[s], lanes, target_speed[s], target_lane[s], previous[s], rule[s], vehicle[s])


@numba.njit  # type: ignore[untyped-decorator]
def _wish_all(rows: Any, home: int, pass_id: Any, out: Any) -> None:
    for s in range(rows.shape[0]):
        out[s] = _wished_lane(rows[s], home, pass_id[s])


class World(Protocol):
    """A batched simulator (see `sim_node.engine.batched`): arrays over S scenes, and a 15 Hz tick."""

    rows: Array
    target_speed: NDArray[np.float64]
    target_lane: NDArray[np.int64]
    previous_lane: NDArray[np.int64]
    accel: NDArray[np.float64]
    crashed: NDArray[np.bool_]

    def tick(self, meta: NDArray[np.int64], speed_goal: NDArray[np.float64]) -> None: ...

    def reset(self, which: NDArray[np.bool_]) -> None: ...


class Scenes:
    """Two-way scenes with randomised directives, stepped one decision at a time."""

    def __init__(self, world: World, lanes: NDArray[np.float64], seed: int, home: int = 1) -> None:
        self.world, self.lanes, self.home = world, lanes, home
        self._rng = np.random.default_rng(seed)
        s = len(world.rows)
        self._rule = np.zeros((s, 6), np.int64)
        self._vehicle = np.zeros((s, 6), np.int64)
        self.pass_id = np.full(s, -1, np.int64)
        self.v_des, self.headway = np.zeros(s), np.zeros(s)
        self.wish = np.zeros(s, np.int64)
        self.age = np.zeros(s, np.int64)
        self.returns = np.zeros(s)
        self.reset(np.ones(s, np.bool_))

    def reset(self, which: NDArray[np.bool_]) -> None:
        """New scenes where told; a directive is drawn for each, and again now and then during the episode."""
        self.world.reset(which)
        self.age[which], self.returns[which] = 0, 0.0
        self._direct(which)
        self._look()

    def _direct(self, which: NDArray[np.bool_]) -> None:
        for s in np.flatnonzero(which):
            rows = self.world.rows[s]
            ahead = [r for r in rows[1:] if r[0] > 0 and int(r[8]) == self.home and r[3] > -0.1 and r[1] > rows[0, 1]]
            overtake = ahead and self._rng.random() < 0.65
            self.pass_id[s] = int(min(ahead, key=lambda r: float(r[1]))[0]) if overtake else -1
            self.v_des[s] = 8.0 if overtake else float(self._rng.integers(0 if self._rng.random() < 0.1 else 3, 9))
            self.headway[s] = self._rng.uniform(1.0, 2.5)

    def _look(self) -> None:
        w = self.world
        _close_all(w.rows, self.lanes, w.target_speed, w.target_lane, w.previous_lane, self._rule, self._vehicle)
        _wish_all(w.rows, self.home, self.pass_id, self.wish)

    def observe(self) -> tuple[Array, NDArray[np.bool_]]:
        """Policy input (S, N, F) and the open actions (S, 5)."""
        w = self.world
        x = policy_input(w.rows, self.lanes[self.wish, 0], self.v_des, self.headway, w.target_speed,
                         (w.previous_lane >= 0).astype(np.float64))
        return x, self._rule[:, :5] == mask.OPEN

    def decide(self, action: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_]]:
        """One second: the action first, then held unless the mask closes that: reward, terminated, truncated.

        Reward per decision (paper Eq. 4), scaled to about 1: efficiency -|v - v_des|/4 and, while overtaking, its
        progress; comfort -a^2 and -0.02 for a step or a change; preference +0.3 in the wished lane; safety -10 for a
        crash, -0.3 for an emergency brake.
        """
        w = self.world
        s = len(action)
        braked, effort = np.zeros(s), np.zeros(s)
        start_x = w.rows[:, 0, 1].copy()
        for k in range(DECISION_TICKS):
            is_open = self._rule == mask.OPEN
            meta = action if k == 0 else np.full(s, MetaAction.CRUISE)
            fine = is_open[np.arange(s), meta]
            for a in (MetaAction.EMERGENCY_BRAKE, MetaAction.RIGHT, MetaAction.SPEED_UP, MetaAction.SLOW_DOWN):
                if not fine.all():
                    meta = np.where(~fine & is_open[:, a], int(a), meta)
            braked += meta == MetaAction.EMERGENCY_BRAKE
            w.tick(meta.astype(np.int64), self.v_des)
            effort += w.accel**2
            self._look()
        self.age += 1
        v = (w.rows[:, 0, 1] - start_x).astype(np.float64)
        lane_kept = w.target_lane == self.wish
        reward = (
            0.6 - np.abs(v - self.v_des) / 4.0 * np.where(v > self.v_des, 1.5, 1.0)
            + 0.3 * lane_kept - 0.05 * effort / DECISION_TICKS - 0.02 * (action != MetaAction.CRUISE)
            - 0.3 * (braked > 0) - 10.0 * w.crashed
        )
        terminated = w.crashed.copy()
        truncated = (self.age >= HORIZON) & ~terminated
        again = (self._rng.random(s) < 0.03) & ~terminated & ~truncated
        if again.any():
            self._direct(again)
            self._look()
        reward = (0.1 * reward).astype(np.float32)
        self.returns += reward
        return reward, terminated, truncated
