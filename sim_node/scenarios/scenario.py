"""What a scenario is: roads, traffic, the ego, success. Data only; one environment and one engine drive them all.

SI units; the road frame of `schemas.wire.messages` (x along the ego's way, y growing to the right, lane 0 leftmost).
Ranges are (low, high) of a uniform draw; of integers both ends are included.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from schemas.driving.episode import Goal
from schemas.driving.intent import ANY_LANE
from schemas.driving.road import NOBODY, lead_id
from schemas.wire.messages import Lane
from sim_node.scenarios.clearance import start_clearance_m
from sim_node.scenarios.manners import NARROW_M, USUAL, VARIED, Manners, draw

Range = tuple[float, float]
PIECE_LANE, PIECE_START, PIECE_END, PIECE_Y, PIECE_AMPLITUDE, PIECE_PULSATION, PIECE_PHASE = range(7)
"""Columns of `Scenario.pieces`."""
GATE_START, GATE_END, GATE_OPENS, GATE_RAMP = range(4)
"""Columns of `Scenario.gates`. OPENS: where changes out of the lane begin; RAMP: 1 where nobody changes into it."""
LEFT_ROAD_M = 20.0
"""Who is this near to the end of its road has left it."""
CLEAR_M = 15.0
"""A car that would start nearer than this to one that is already there, centre to centre, is left out."""
DENSITIES = (0.2, 3.0)
"""Times a road's own traffic: beyond, cars would start inside each other."""
ALWAYS = -math.inf


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A stretch of a lane's centre line: y = y_m + amplitude_m * sin(pulsation * (x - start_m) + phase).

    `edge` names the road that it belongs to, as highway-env does: pieces of several lanes on one edge are side by side
    and cars may change between them. Lane changes between edges do not exist.
    """

    edge: tuple[str, str]
    start_m: float
    end_m: float
    y_m: float
    amplitude_m: float = 0.0
    pulsation: float = 0.0
    """rad/m"""
    phase: float = 0.0


@dataclass(frozen=True, kw_only=True)
class LanePlan:
    """One lane, from its first piece to its last."""

    pieces: tuple[Piece, ...]
    speed_limit_mps: float
    direction: Literal[1, -1] = 1
    """-1: oncoming, drawn on the map in both directions so that a car that borrows it has a lane to be in."""
    kind: Literal["main", "ramp", "oncoming"] = "main"
    change_from_m: float = ALWAYS
    """Nobody changes out of it before this x; into a ramp nobody changes at all."""
    width_m: float = 4.0


@dataclass(frozen=True, kw_only=True)
class Flow:
    """Cars on one lane, placed one after the other from near to far."""

    lane: int | Literal["ego", "others"]
    """An index, the ego's own lane, or (one draw for each) all the other lanes."""
    count: tuple[int, int]
    start: Literal["ahead", "behind", "at"]
    """`first_m` counts from the ego forwards, from the ego backwards, or is an x from where the flow goes forwards."""
    first_m: Range
    gap_m: Range
    gap_s: Range = (0.0, 0.0)
    """Centre to centre, one car to the next: gap_m + gap_s * speed of the car that is placed."""
    speed_mps: Range
    target_mps: Range | None = None
    """None: `eagerness` times the speed it starts with."""
    eagerness: float = 1.0
    not_faster_than_ego: bool = False
    """Starts at most as fast as the ego, so that no scene opens with a forced braking."""
    lane_changes: bool = True
    probability: float = 1.0
    """That the flow exists at all."""


@dataclass(frozen=True, kw_only=True)
class EgoPlan:
    """How the ego starts, and what its executor may be asked for."""

    lanes: tuple[int, ...]
    x_m: Range
    speed_mps: Range
    speed_ceiling_mps: float
    speed_floor_mps: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Success:
    """What counts, besides no collision, at the end of an episode. Every condition that is set must hold."""

    mean_speed_mps: float = 0.0
    reach_x_m: float = -math.inf
    reach_lanes: tuple[int, ...] = ()
    """Where to be at the end, if anywhere; ends the episode once `reach_x_m` is reached in one of them."""
    pass_first_lead: bool = False
    """Vehicle 1 is behind, and the ego is in its own lane again."""


@dataclass(frozen=True, kw_only=True)
class Expect:
    """What `make difficulty` must find, or the scene is a defect: neither trivial nor hopeless."""

    constant_success_max: float = 0.5
    """Of every driver that repeats one action."""
    survivable: float = 1.0
    """Share of seeds in which at least one driver (IDM, a rule behind the mask, braking) does not collide."""


class Spawn(NamedTuple):
    """Vehicles at time 0, the ego first; SI units, road frame."""

    x: NDArray[np.float64]
    lane: NDArray[np.int64]
    """Index in the scenario's lanes."""
    direction: NDArray[np.int64]
    """+1 with the ego, -1 oncoming."""
    speed: NDArray[np.float64]
    """Along the vehicle's own direction, so never negative."""
    target_speed: NDArray[np.float64]
    delta: NDArray[np.float64]
    """IDM's speed exponent."""
    timer: NDArray[np.float64]
    """Since when it last considered a lane change, s."""
    lane_changes: NDArray[np.bool_]
    """Whether it considers them at all."""
    manners: NDArray[np.float64]
    """(V, 11) in the columns of `sim_node.scenarios.manners`."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One road with its traffic, the ego's task, and when that is done."""

    name: str
    description: str
    lanes: tuple[LanePlan, ...]
    """From left to right."""
    ego: EgoPlan
    flows: tuple[Flow, ...]
    success: Success
    end_x_m: float
    """An episode ends when the ego gets here; the road goes on, for upstream cars turn round at its very end."""
    duration_s: float = 40.0
    speed_set: Literal["paper", "natural"] = "paper"
    wish_lanes: tuple[int, ...] = ()
    """Lanes that a directive may name in training and evaluation; empty where an overtake is what may be wished."""
    obstacles: tuple[tuple[int, float], ...] = ()
    """(lane, x) of things that stand there."""
    connected_lanes: bool = False
    """Whether drivers see past the end of their piece of road (highway-env's option of the same meaning)."""
    sight_m: float = 200.0
    """How far the ego sees."""
    delta: Range = (3.5, 4.5)
    starts_clear: bool = False
    """The ego starts outside the RSS distances to whoever is ahead and behind in its lane, at every density: a car that
    was drawn nearer starts farther away, or not at all where its place is that of an "at" flow."""
    manners: Manners = USUAL
    expect: Expect = Expect()

    def __post_init__(self) -> None:
        for flow in self.flows:
            if isinstance(flow.lane, int) and not 0 <= flow.lane < len(self.lanes):
                raise ValueError(f"scenario {self.name!r}: a flow is on lane {flow.lane} of {len(self.lanes)} lanes")
        if not set(self.ego.lanes) <= set(range(len(self.lanes))) or not self.ego.lanes:
            raise ValueError(f"scenario {self.name!r}: ego lanes {self.ego.lanes} of {len(self.lanes)} lanes")

    def denser(self, factor: float) -> Scenario:
        """The same road with `factor` times the density: every gap and first distance is divided by it.

        Raises ValueError unless the factor is within `DENSITIES`.
        """
        check_density(factor)

        def shorter(r: Range) -> Range:
            return r[0] / factor, r[1] / factor

        return replace(
            self,
            flows=tuple(
                replace(
                    f,
                    gap_m=shorter(f.gap_m),
                    gap_s=shorter(f.gap_s),
                    first_m=f.first_m if f.start == "at" else shorter(f.first_m),
                )
                for f in self.flows
            ),
        )

    def narrower(self, width_m: float) -> Scenario:
        """The same road with lanes of this width: whatever lies beside the first lane's centre comes nearer by the
        same factor."""
        factor = width_m / self.lanes[0].width_m

        def nearer(piece: Piece) -> Piece:
            return replace(piece, y_m=factor * piece.y_m, amplitude_m=factor * piece.amplitude_m)

        return replace(
            self,
            lanes=tuple(
                replace(plan, width_m=factor * plan.width_m, pieces=tuple(map(nearer, plan.pieces)))
                for plan in self.lanes
            ),
        )

    def varied(self, names: Sequence[str] = (), density: float = 1.0) -> Scenario:
        """The same road with other traffic, by names of `manners.VARIED`, `density` times as dense.

        Raises ValueError for another name, and as `denser` does.
        """
        unknown = sorted(set(names) - set(VARIED))
        if unknown:
            raise ValueError(f"traffic {', '.join(unknown)}: choose from {', '.join(VARIED)}")
        fields = {field: value for name in names for field, value in VARIED[name].items()}
        base = self if density == 1.0 else self.denser(density)
        other = replace(base, manners=replace(base.manners, **fields))
        return other.narrower(NARROW_M) if "narrow" in names else other

    @property
    def goal(self) -> Goal:
        """Where an episode ends."""
        return Goal(self.success.reach_x_m, self.success.reach_lanes, self.end_x_m)

    @property
    def vehicles_max(self) -> int:
        """The most vehicles that `spawn` makes, the ego included."""
        return 1 + sum(f.count[1] * (len(self.lanes) - 1 if f.lane == "others" else 1) for f in self.flows)

    @property
    def road_end_m(self) -> float:
        """Where the longest lane ends."""
        return max(plan.pieces[-1].end_m for plan in self.lanes)

    @cached_property
    def _pieces(self) -> list[tuple[float, ...]]:
        return [
            (float(lane), p.start_m, p.end_m, p.y_m, p.amplitude_m, p.pulsation, p.phase)
            for lane, plan in enumerate(self.lanes)
            for p in plan.pieces
        ]

    def pieces(self) -> NDArray[np.float64]:
        """(P, 7) in the columns `PIECE_...`: the table that `centre_line` reads."""
        return np.array(self._pieces)

    def gates(self) -> NDArray[np.float64]:
        """(L, 4) in the columns `GATE_...`: where lane changes are possible at all."""
        return np.array(
            [
                (plan.pieces[0].start_m, plan.pieces[-1].end_m, plan.change_from_m, plan.kind == "ramp")
                for plan in self.lanes
            ],
            np.float64,
        )

    def lanes_at(self, x_m: float) -> tuple[Lane, ...]:
        """The lanes as they are published to an ego at `x_m`."""
        table = self._pieces
        return tuple(
            Lane(
                y_m=round(centre_line(table, lane, x_m)[0], 9),
                start_m=plan.pieces[0].start_m,
                end_m=plan.pieces[-1].end_m,
                direction=plan.direction,
                width_m=plan.width_m,
                speed_limit_mps=plan.speed_limit_mps,
                kind=plan.kind,
                change_from_m=max(plan.change_from_m, -1e9),
            )
            for lane, plan in enumerate(self.lanes)
        )

    def spawn(self, rng: Generator) -> Spawn:
        """Draw the vehicles of one episode: the ego, then flow by flow. Pure: equal generators give equal vehicles."""
        ego_lane = int(rng.choice(self.ego.lanes))
        cars = [(rng.uniform(*self.ego.x_m), ego_lane, rng.uniform(*self.ego.speed_mps), math.nan, False)]
        ego_x, _, ego_speed, _, _ = cars[0]
        for flow in self.flows:
            if flow.lane == "others":
                chosen = [k for k in range(len(self.lanes)) if k != ego_lane]
            else:
                chosen = [ego_lane if flow.lane == "ego" else flow.lane]
            for lane in chosen:
                if rng.random() >= flow.probability:
                    continue
                at, way = (0.0, 1.0) if flow.start == "at" else (ego_x, 1.0 if flow.start == "ahead" else -1.0)
                for i in range(int(rng.integers(flow.count[0], flow.count[1] + 1))):
                    speed = rng.uniform(*flow.speed_mps)
                    target = flow.eagerness * speed if flow.target_mps is None else rng.uniform(*flow.target_mps)
                    if flow.not_faster_than_ego:
                        speed = min(speed, ego_speed)
                    gap = rng.uniform(*flow.gap_m) + rng.uniform(*flow.gap_s) * speed
                    at += way * (rng.uniform(*flow.first_m) if i == 0 else gap)
                    if self.starts_clear and lane == ego_lane:
                        least = start_clearance_m(speed, ego_speed, ahead=at >= ego_x)
                        if flow.start == "at" and abs(at - ego_x) < least:
                            continue
                        if flow.start != "at":
                            at = ego_x + way * max(way * (at - ego_x), least)
                    if all(abs(at - x) >= CLEAR_M for x, k, *_ in cars if k == lane):
                        cars.append((at, lane, speed, target, flow.lane_changes))
        x, lane_of, speeds, targets, changes = (np.array(column) for column in zip(*cars, strict=True))
        targets[0] = speeds[0]
        directions = np.array([plan.direction for plan in self.lanes], np.int64)
        n = len(cars)
        return Spawn(
            x,
            lane_of,
            directions[lane_of],
            speeds,
            targets,
            rng.uniform(*self.delta, size=n),
            rng.uniform(0.0, 1.0, size=n),
            changes,
            draw(self.manners, rng, x, lane_of),
        )


def streams(seed: int) -> tuple[Generator, Generator, Generator]:
    """Independent generators of one episode, from one SeedSequence: traffic, wishes, perception."""
    traffic, wishes, perception = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    return traffic, wishes, perception


def draw_wish(
    scenario: Scenario, rng: Generator, rows: Any, home: int, overtake_share: float = 0.65
) -> tuple[int, int, float, float]:
    """A random directive, as in training: (lane or `ANY_LANE`, id of the car to overtake or -1, speed, headway).

    Half of the lane wishes leave the lane open, where there is more than one; where `wish_lanes` is empty an overtake
    is wished, or to stay.
    """
    low, high = scenario.ego.speed_floor_mps, scenario.ego.speed_ceiling_mps
    eager = rng.random() < 0.5
    # Seldom a crawl: a passenger who wants to stand still is rare, one who wants to go on is not.
    speed = high if eager else float(rng.uniform(low if rng.random() < 0.1 else 0.5 * high, high))
    headway = float(rng.uniform(0.8, 2.5))
    if scenario.wish_lanes:
        chooses = len(scenario.wish_lanes) > 1 and rng.random() < 0.5
        lane = ANY_LANE if chooses else int(rng.choice(scenario.wish_lanes))
        return lane, NOBODY, speed, headway
    lead = lead_id(rows, home)
    if lead >= 0 and rng.random() < overtake_share:
        return home, lead, high, headway
    return home, NOBODY, speed, headway


def check_density(factor: float) -> None:
    """Raises ValueError unless it is within `DENSITIES`."""
    if not DENSITIES[0] <= factor <= DENSITIES[1]:
        raise ValueError(f"density {factor:g} is not within {DENSITIES[0]:g}..{DENSITIES[1]:g}")


def centre_line(pieces: Any, lane: int, x: float) -> tuple[float, float]:
    """Centre of `lane` at `x` (m) and its heading there (rad): (y, heading). Compiles with numba unchanged.

    pieces: (P, 7) as `Scenario.pieces`; before the first and beyond the last piece the lane goes straight on.
    """
    found = -1
    for i in range(len(pieces)):
        if pieces[i][PIECE_LANE] == lane and (found < 0 or x >= pieces[i][PIECE_START]):
            found = i
    p = pieces[found]
    if p[PIECE_AMPLITUDE] == 0.0:
        return p[PIECE_Y], 0.0
    along = min(max(x, p[PIECE_START]), p[PIECE_END]) - p[PIECE_START]
    angle = p[PIECE_PULSATION] * along + p[PIECE_PHASE]
    slope = p[PIECE_AMPLITUDE] * p[PIECE_PULSATION] * math.cos(angle)
    return p[PIECE_Y] + p[PIECE_AMPLITUDE] * math.sin(angle), math.atan(slope)


def straight(edge: tuple[str, str], length_m: float, y_m: float) -> tuple[Piece, ...]:
    """A lane of one straight piece from x = 0."""
    return (Piece(edge=edge, start_m=0.0, end_m=length_m, y_m=y_m),)
