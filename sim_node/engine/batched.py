"""Many scenes of one scenario at once, for training and evaluation: the ticks of `sim_node.env`, bit for bit.

Axes: S scenes, V vehicles, L lanes. SI units, 15 Hz.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from highway_env.road.road import Road
from numpy.typing import NDArray

from schemas.driving.measures import CAR_LENGTH_M
from schemas.driving.road import DT_S, HZ, LANE_END, LENGTH, WIDTH
from schemas.runtime.compiled import compiled
from schemas.wire.messages import ROW_COLUMNS
from sim_node.actuator import check
from sim_node.engine import tables
from sim_node.engine.bridge import NO_VIEW, Bridge, new_ego
from sim_node.engine.kernel import layout, tick
from sim_node.engine.kernel.layout import ABSENT_X_M, View
from sim_node.road import lane_index, network
from sim_node.scenarios.scenario import LEFT_ROAD_M, PIECE_LANE, PIECE_START, Scenario, Spawn

OBSTACLE_M = 2.0

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def _check_all(
    rows: Any, lane_y: Any, lane_end: Any, target_lane: Any, previous: Any, meta: Any, done: Any, refused: Any
) -> None:
    """Of every scene, what the actuator does of `meta` (S,) and why: into `done` and `refused`."""
    for s in range(rows.shape[0]):
        done[s], refused[s], _ = check(rows[s], lane_y[s], lane_end, meta[s], target_lane[s], previous[s])


_check = compiled(_check_all)


class Batched:
    """`scenes` independent scenes. A crashed scene stands still, its tick too, until it is reset.

    Scene k draws its episodes from the k-th child of `SeedSequence(seed)`, whatever the other scenes do. Vehicle 0 is
    the ego; the order is the spawn's and stays.
    """

    rows: NDArray[np.float32]
    """(S, V, 9) as `ROW_COLUMNS`, all vehicles; id -1 for one that is absent or farther than the scenario's sight."""
    lane_y: Floats
    """(S, L) y of every lane beside the ego."""
    target_speed: Floats
    """(S,) set-points of the executor; an IDM ego's wishes."""
    target_lane: Ints
    previous_lane: Ints
    """(S,) the lane that a running change left, or -1."""
    accel: Floats
    """(S,) the ego's acceleration over the last tick."""
    crashed: Bools
    refused: Ints
    """(S,) why the actuator did not carry out the last tick's action (`actuator.REASONS`); 0 where it did."""
    ticks: Ints
    x: Floats
    """(S, V) the state behind `rows`, as are `y`, `heading` and `speed`; absent vehicles are at `ABSENT_X_M`."""

    def __init__(
        self,
        scenario: Scenario,
        scenes: int,
        seed: int,
        *,
        ego: Literal["executor", "idm"] = "executor",
        actuator: bool = False,
    ) -> None:
        """ego: "executor" takes actions; "idm" drives by itself, as fast as its speed goal: IDM and, where no lane is
        oncoming, MOBIL. actuator: check every action last, as the running simulator does (`sim_node.actuator`).

        Raises ValueError for another ego.
        """
        if ego not in ("executor", "idm"):
            raise ValueError(f"ego {ego!r} is neither 'executor' nor 'idm'")
        self.scenario, self.scenes = scenario, scenes
        self._actuator, self._done, self.refused = actuator, np.zeros(scenes, np.int64), np.zeros(scenes, np.int64)
        self._kind = layout.EXECUTOR if ego == "executor" else layout.TRAFFIC
        self._tables = tables.read(network(scenario), scenario.connected_lanes)
        self._pieces = scenario.pieces()
        self._lane_of_piece = _lanes_of_pieces(scenario, self._tables)
        vehicles, things, lanes_n = scenario.vehicles_max, len(scenario.obstacles), len(scenario.lanes)
        n = vehicles + things
        self.vehicles = vehicles
        self._f, self._g = np.zeros((scenes, layout.FLOATS, n)), np.zeros((scenes, layout.INTS, n), np.int64)
        self._scratch, self._calls = layout.new_scratch(n, len(self._tables.lanes)), layout.new_calls()
        bounds = scenario.ego
        self._ego = new_ego(
            scenes,
            np.array([0.0, 1.0]),
            True,
            self._pieces,
            scenario.gates(),
            bounds.speed_floor_mps,
            bounds.speed_ceiling_mps,
        )
        self.rows = np.zeros((scenes, vehicles, len(ROW_COLUMNS)), np.float32)
        self.lane_y = np.zeros((scenes, lanes_n))
        self._view = View(
            self.rows,
            _published(scenario),
            self.lane_y,
            _lanes_of_network(self._tables, self._lane_of_piece, self._pieces),
            float(scenario.road_end_m - LEFT_ROAD_M),
            float(scenario.sight_m),
        )
        e = self._ego
        self.target_speed, self.target_lane, self.previous_lane = e.target_speed, e.target_lane, e.previous_lane
        self.accel, self.crashed, self.ticks = e.accel, e.crashed, e.ticks
        self.x, self.y = self._f[:, layout.X, :vehicles], self._f[:, layout.Y, :vehicles]
        self.heading, self.speed = self._f[:, layout.ANGLE, :vehicles], self._f[:, layout.SPEED, :vehicles]
        self._rngs = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(scenes)]
        self.reset(np.ones(scenes, np.bool_))

    def reset(self, mask: Bools) -> None:
        """Start a new episode in every scene where `mask` (S,) is set."""
        for scene in np.flatnonzero(mask):
            self.load(int(scene), self.scenario.spawn(self._rngs[scene]))

    def load(self, scene: int, spawn: Spawn) -> None:
        """Put these vehicles into one scene, at tick 0. Raises ValueError for more than the scenario's most."""
        n, first_thing = len(spawn.x), self.vehicles
        if n > first_thing:
            raise ValueError(f"{n} vehicles, but scenario {self.scenario.name!r} has at most {first_thing}")
        f, g, e = self._f[scene], self._g[scene], self._ego
        f[:], g[:] = 0.0, 0
        f[layout.X], f[layout.DELTA] = ABSENT_X_M, 1.0
        f[layout.CAR_LENGTH], f[layout.CAR_WIDTH] = CAR_LENGTH_M, layout.VEHICLE_WIDTH_M
        lane, way = np.zeros(f.shape[1], np.int64), np.ones(f.shape[1], np.int64)
        f[layout.X, :n], lane[:n], way[:n] = spawn.x, spawn.lane, spawn.direction
        f[layout.SPEED, :n], f[layout.TARGET_SPEED, :n] = spawn.speed, spawn.target_speed
        f[layout.DELTA, :n], f[layout.TIMER, :n] = spawn.delta, spawn.timer
        g[layout.KIND, :n] = layout.TRAFFIC
        g[layout.KIND, 0] = self._kind
        g[layout.CHANGES, :n], g[layout.CHECKS] = spawn.lane_changes, 1
        for i, (k, at) in enumerate(self.scenario.obstacles, first_thing):
            f[layout.X, i], lane[i], g[layout.KIND, i] = at, k, layout.OBSTACLE
            f[layout.CAR_LENGTH, i] = OBSTACLE_M
        g[layout.TARGET_LANE, :n] = self._lane_numbers(spawn)
        for i in range(0 if self._kind == layout.TRAFFIC else 1, n):
            layout.set_manners(f, i, spawn.manners[i])
        if self._kind == layout.EXECUTOR:
            f[layout.DELTA, 0], f[layout.TIMER, 0], g[layout.CHANGES, 0], g[layout.TARGET_LANE, 0] = 1.0, 0.0, 0, 0
        else:
            g[layout.CHANGES, 0] = all(plan.direction > 0 for plan in self.scenario.lanes)
        self.target_speed[scene], self.target_lane[scene] = spawn.target_speed[0], spawn.lane[0]
        self.previous_lane[scene], self.accel[scene] = -1, 0.0
        self.crashed[scene], self.ticks[scene] = False, 0
        e.meta[scene] = layout.IDLE
        if self._kind != layout.EXECUTOR:
            self.target_speed[scene] = self.scenario.ego.speed_ceiling_mps
        rows = self.rows[scene]
        rows[:] = 0.0
        rows[:, LENGTH], rows[:, WIDTH] = CAR_LENGTH_M, layout.VEHICLE_WIDTH_M
        tick.settle(self._tables.roads, self._calls, self._scratch, self._f, self._g, e, self._view, scene, lane, way)
        g[layout.TARGET_LANE, first_thing:] = g[layout.LANE, first_thing:]

    def tick(self, meta: Ints, speed_goal: Floats, speed_cap: Floats | float = math.inf, style: Ints | int = 1) -> None:
        """Advance every scene by 1/15 s: one `MetaAction` (S,) per scene, its speed goal (S,) and cap (S,) in m/s (nan
        and inf: none), and its style (S,)."""
        self._ego.speed_goal[:], self._ego.speed_cap[:], self._ego.style[:] = speed_goal, speed_cap, style
        meta = np.ascontiguousarray(meta, np.int64)
        if self._actuator:
            e = self._ego
            _check(
                self.rows, self.lane_y, self._view.lanes[:, LANE_END], e.target_lane, e.previous_lane, meta,
                self._done, self.refused,
            )  # fmt: skip
            meta = self._done
        tick.advance(
            1, DT_S, self._tables.roads, self._calls, self._scratch, self._f, self._g, self._ego, self._view, meta
        )

    def copy(self, other: Batched, scenes: Ints) -> None:
        """Become `scenes` (S,) of another of the same scenario, one after the other: to try what may come of them."""
        self._f[:], self._g[:] = other._f[scenes], other._g[scenes]
        for name in layout.EGO_STATE:
            getattr(self._ego, name)[:] = getattr(other._ego, name)[scenes]
        self.rows[:], self.lane_y[:] = other.rows[scenes], other.lane_y[scenes]

    def keep_going(self) -> None:
        """From now on crashed scenes go on, as upstream's do."""
        self._ego = self._ego._replace(freezes=False)

    def state(self, scene: int) -> tuple[Floats, Ints]:
        """Copies of the kernel's arrays of all that is on one scene's road: see `layout.X` and `layout.KIND`."""
        f, g = self._f[scene], self._g[scene]
        here = g[layout.KIND] != layout.ABSENT
        return f[:, here], g[:, here]

    def _lane_numbers(self, spawn: Spawn) -> Ints:
        """The network's lane under each vehicle."""
        starts = np.where(
            self._pieces[None, :, PIECE_LANE] == spawn.lane[:, None], self._pieces[None, :, PIECE_START], np.inf
        )
        reached = (starts <= spawn.x[:, None]) & np.isfinite(starts)
        last = self._pieces.shape[0] - 1 - np.argmax(reached[:, ::-1], axis=1)
        piece = np.where(reached.any(axis=1), last, np.argmin(starts, axis=1))
        return np.asarray(self._lane_of_piece[piece])


class BatchedRoads:
    """Scenes that start as highway-env's own roads, all on the same network; for comparisons with upstream."""

    def __init__(self, roads: Sequence[Road], hz: int = HZ) -> None:
        """Takes the state of every road. Raises `tables.UnsupportedError` for what the kernel does not know."""
        scenes = [Bridge() for _ in roads]
        for scene, road in zip(scenes, roads, strict=True):
            scene.read(road)
        known = scenes[0].tables
        n = max(scene.f.shape[2] for scene in scenes)
        self.dt, self.tables = 1.0 / hz, known
        self.f, self.g = np.zeros((len(roads), layout.FLOATS, n)), np.zeros((len(roads), layout.INTS, n), np.int64)
        self.f[:, layout.X], self.f[:, layout.DELTA], self.f[:, layout.CAR_LENGTH] = ABSENT_X_M, 1.0, CAR_LENGTH_M
        for k, scene in enumerate(scenes):
            self.f[k, :, : scene.f.shape[2]], self.g[k, :, : scene.g.shape[2]] = scene.f[0], scene.g[0]
        self.ego = new_ego(len(roads), scenes[0].ego.speeds)
        self.ego.target_speed[:] = self.f[:, layout.TARGET_SPEED, 0]
        self._scratch, self._calls = layout.new_scratch(n, len(known.lanes)), layout.new_calls()

    def tick(self, action: Ints, ticks: int = 1) -> None:
        """Advance by `ticks`; action (S,) by number as `DiscreteMetaAction`'s, at the first tick."""
        tick.advance(
            ticks,
            self.dt,
            self.tables.roads,
            self._calls,
            self._scratch,
            self.f,
            self.g,
            self.ego,
            NO_VIEW,
            np.ascontiguousarray(action, np.int64),
        )


def _published(scenario: Scenario) -> Floats:
    table = []
    for plan in scenario.lanes:
        straight = len({p.y_m for p in plan.pieces}) == 1 and not any(p.amplitude_m for p in plan.pieces)
        table.append((plan.pieces[0].y_m if straight else np.nan, plan.pieces[0].start_m, plan.pieces[-1].end_m))
    return np.array(table)


def _lanes_of_pieces(scenario: Scenario, known: tables.Tables) -> Ints:
    """(P,) the network's lane of each piece, in the direction of its traffic."""
    return np.array(
        [
            known.number[lane_index(scenario, lane, piece.start_m)]
            for lane, plan in enumerate(scenario.lanes)
            for piece in plan.pieces
        ]
    )


def _lanes_of_network(known: tables.Tables, lane_of_piece: Ints, pieces: Floats) -> Ints:
    """(N,) the scenario's lane of each of the network's; an oncoming lane's way with the ego is that lane, too."""
    out = np.zeros(len(known.lanes), np.int64)
    for k, (start, end, i) in enumerate(known.indices):
        found = np.flatnonzero(lane_of_piece == k)
        if not len(found):
            found = np.flatnonzero(lane_of_piece == known.number.get((end, start, i), -1))
        if len(found):
            out[k] = int(pieces[found[0], PIECE_LANE])
    return out
