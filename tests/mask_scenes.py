"""Roads, cars and an ego that moves as the simulator moves it: what the tests of the mask are made of."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import strategies as st

from fast_node.mask import OPEN, PRESETS, REASONS, Preset, close_actions
from fast_node.mask.neighbours import half_width, survey
from fast_node.mask.vocabulary import Situation
from schemas.driving.measures import rss_same_direction_m
from schemas.driving.road import (
    HEADING,
    ID,
    LANE_END,
    LANE_LIMIT,
    LANE_OPENS,
    LANE_RAMP,
    LANE_START,
    LANE_WAY,
    LANE_Y,
    VX,
    VY,
    X,
    Y,
    lane_table,
)
from schemas.wire.messages import MetaAction
from sim_node import executor
from tests import scenes as by_hand
from tests.scenes import car

SIGHT_M = 250.0
NORMAL = 1

SIM = PRESETS["sim"]
PLAIN = Preset(
    reaction_s=0.5,
    ego_brake=4.0,
    shown_brake=4.0,
    lead_brake=8.0,
    standstill_m=3.0,
    follow_s=1.0,
    ceiling_reaction_s=0.5,
    ceiling_brake=4.0,
    follower_reaction_s=1.0,
    follower_brake=5.0,
    courtesy_brake=0.75,
    side_accel=0.5,
    side_brake=2.0,
    sway_m=0.25,
)
"""Round numbers, for distances worked out by hand."""


ROADS_BY_HAND = {"two-way": by_hand.TWO_WAY, "highway": by_hand.HIGHWAY, "merge": by_hand.MERGE}
ROADS = {name: lane_table(lanes) for name, lanes in ROADS_BY_HAND.items()}
LANES, HIGHWAY, RAMP = ROADS["two-way"], ROADS["highway"], ROADS["merge"]


def judge(
    rows, lanes, target_speed: float, lane: int, previous: int = -1, preset: Preset = SIM
) -> tuple[list[int], list[int]]:
    return capped(rows, lanes, target_speed, lane, previous, preset)[:2]


def capped(
    rows, lanes, target_speed: float, lane: int, previous: int = -1, preset: Preset = SIM
) -> tuple[list[int], list[int], float]:
    """The same, and the speed cap [m/s]."""
    reasons, vehicle = [0] * 6, [0] * 6
    near = [0] * (3 * len(lanes))
    cap = close_actions(rows, lanes, target_speed, lane, previous, SIGHT_M, near, reasons, vehicle, preset)
    return reasons, vehicle, cap


def situation(
    rows: list[list[float]],
    lanes=HIGHWAY,
    lane: int = 1,
    previous: int = -1,
    speed: float = 10.0,
    preset: Preset = PLAIN,
    sight: float = SIGHT_M,
) -> Situation:
    """What the claims read of a scene; speed: the set-point."""
    near = [0] * (3 * len(lanes))
    return Situation(rows, lanes, near, speed, lane, previous, sight, survey(rows, lanes, near), preset)


def moving(row: list[float], sideways: float = 0.0, sine: float = 0.0) -> list[float]:
    """The same car with a motion sideways [m/s] and a heading of this sine."""
    row = list(row)
    row[VY], row[HEADING] = sideways, math.asin(sine)
    return row


def closed(rows: list[list[float]], *, target_speed: float = 5.0, lane: int = 1, previous: int = -1) -> dict[int, str]:
    reasons, _ = judge(rows, LANES, target_speed, lane, previous)
    return {a: REASONS[r] for a, r in enumerate(reasons) if r != OPEN}


def closed_on(lanes, rows, lane: int, previous: int = -1, target_speed: float | None = None) -> dict[int, str]:
    reasons, _ = judge(rows, lanes, rows[0][VX] if target_speed is None else target_speed, lane, previous)
    return {a: REASONS[r] for a, r in enumerate(reasons) if r != OPEN}


EGO_X_M = {"two-way": (500.0, 500.0), "highway": (500.0, 500.0), "merge": (200.0, 345.0)}


class Scene(NamedTuple):
    """All that the mask may read, but for the preset."""

    lanes: list[tuple[float, ...]]
    rows: list[list[float]]
    target_speed: float
    lane: int
    previous: int


def nearest_lane(lanes, y: float) -> int:
    return min(range(len(lanes)), key=lambda k: abs(lanes[k][LANE_Y] - y))


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """Any road, a change under way or none, cars anywhere on it, moving sideways and standing askew."""
    name = draw(st.sampled_from(sorted(ROADS)))
    lanes = ROADS[name]
    top = 1.5 * lanes[-1][LANE_LIMIT]
    aim = draw(st.integers(0, len(lanes) - 1))
    previous = draw(st.sampled_from([-1, *(k for k in (aim - 1, aim + 1) if 0 <= k < len(lanes))]))
    start_y = lanes[aim if previous < 0 else previous][LANE_Y]
    y = start_y + draw(st.floats(0.0, 1.0)) * (lanes[aim][LANE_Y] - start_y)
    sideways, askew = st.floats(-2.5, 2.5), st.floats(-0.6, 0.6)
    changing = previous >= 0
    rows = [
        car(
            0,
            draw(st.floats(*EGO_X_M[name])),
            nearest_lane(lanes, y),
            draw(st.floats(0, top)),
            y,
            vy_mps=draw(sideways) if changing else 0.0,
            heading_rad=draw(askew) if changing else 0.0,
        )
    ]
    others = draw(
        st.lists(
            st.tuples(
                st.floats(-100, 200),
                st.floats(-0.5, lanes[-1][LANE_Y] + 0.5),
                st.floats(0, top),
                st.just(0.0) | sideways,
                st.just(0.0) | askew,
            ),
            max_size=10,
        )
    )
    for number, (dx, aside, speed, vy, heading) in enumerate(others, 11):
        k = nearest_lane(lanes, aside)
        along = math.copysign(speed, lanes[k][LANE_WAY])
        rows.append(car(number, rows[0][X] + dx, k, along, aside, vy_mps=vy, heading_rad=heading))
    rows = np.array(rows, np.float32).tolist()  # as they come over the bus
    return Scene(lanes, rows, draw(st.floats(0, top)), aim, previous)


presets = st.sampled_from(sorted(PRESETS))

DT = 1 / 15

Motion = Callable[[float], tuple[float, float]]
"""Time [s] to where a car is [m] and its speed [m/s], both along the road."""


def braking(x: float, v: float, brake: float, reaction_s: float = 0.0, accel: float = 0.0) -> Motion:
    """A car that accelerates until it reacts, and then brakes to a standstill."""

    def at(t: float) -> tuple[float, float]:
        early = min(t, reaction_s)
        peak = v + accel * early
        late = min(t - early, peak / brake)
        return x + v * early + 0.5 * accel * early**2 + peak * late - 0.5 * brake * late**2, peak - brake * late

    return at


def steady(x: float, v: float) -> Motion:
    return lambda t: (x + v * t, v)


def pulls_away(gap: float, lead_mps: float, mps: float, p: Preset) -> bool:
    """Whether a lead is faster than the ego, and nearer than one of its speed must be: it has come in and is taken
    to pull away."""
    return lead_mps > mps and gap < 2.0 + rss_same_direction_m(
        mps, mps, p.reaction_s, 1.0, p.ego_brake + 1.0, p.lead_brake
    )


class Ego(NamedTuple):
    x: float
    y: float
    speed: float
    heading: float
    accel: float
    target_speed: float
    lane: int
    previous: int

    def moved(self, meta: int, lanes, speed_ceiling: float, cap: float = math.inf) -> Ego:
        """One tick later, as the simulator's executor and bicycle model have it."""
        gates = [(b[LANE_START], b[LANE_END], b[LANE_OPENS], b[LANE_RAMP]) for b in lanes]
        target, lane, previous = executor.edit_set_points(
            meta, self.target_speed, self.lane, self.previous, gates, self.x, math.nan, 0.0, speed_ceiling, cap
        )
        accel = executor.acceleration_command(self.speed, min(target, cap), self.accel, meta, NORMAL, DT)
        steering = executor.steering_command(self.y, self.heading, self.speed, lanes[lane][LANE_Y], 0.0)
        slip = math.atan(0.5 * math.tan(steering))
        y = self.y + self.speed * math.sin(self.heading + slip) * DT
        if previous >= 0 and executor.change_finished(y, lanes[lane][LANE_Y]):
            previous = -1
        return Ego(
            self.x + self.speed * math.cos(self.heading + slip) * DT,
            y,
            self.speed + accel * DT,
            self.heading + self.speed * math.sin(slip) / 2.5 * DT,
            accel,
            target,
            lane,
            previous,
        )

    def row(self, lanes) -> list[float]:
        along, aside = self.speed * math.cos(self.heading), self.speed * math.sin(self.heading)
        near = nearest_lane(lanes, self.y)
        return car(0, self.x, near, along, self.y, vy_mps=aside, heading_rad=self.heading)


def ahead_by(
    seconds: float,
    ego: Ego,
    lanes,
    others: Sequence[tuple[int, Motion]],
    first: int,
    liking: Sequence[int],
    preset: Preset,
) -> Iterator[tuple[Ego, list[list[float]]]]:
    """What becomes of `first` and then, at each tick, of the most liked action that the mask leaves open: the ego and
    all rows after every tick. Nothing, if the mask closes `first`. others: (lane, motion); who is out of sight is not
    seen."""
    for tick in range(round(seconds / DT)):
        rows = rows_at(tick * DT, ego, lanes, others)
        seen = [r for r in rows if abs(r[X] - ego.x) <= SIGHT_M]
        reasons, _, cap = capped(seen, lanes, ego.target_speed, ego.lane, ego.previous, preset)
        if tick == 0 and reasons[first] != OPEN:
            return
        meta = first if tick == 0 else next((a for a in liking if reasons[a] == OPEN), MetaAction.EMERGENCY_BRAKE)
        ego = ego.moved(int(meta), lanes, lanes[-1][LANE_LIMIT], cap)
        yield ego, rows_at((tick + 1) * DT, ego, lanes, others)


def rows_at(t: float, ego: Ego, lanes, others) -> list[list[float]]:
    return [ego.row(lanes), *(car(i, at(t)[0], lane, at(t)[1]) for i, (lane, at) in enumerate(others, 1))]


def touched(rows) -> list[int]:
    """Ids of the cars that the ego overlaps."""
    ego = rows[0]
    return [
        int(r[ID])
        for r in rows[1:]
        if abs(r[X] - ego[X]) < 5.0 and abs(r[Y] - ego[Y]) < half_width(r) + half_width(ego)
    ]


LEFT, RIGHT = MetaAction.LEFT, MetaAction.RIGHT

EAGER = (MetaAction.SPEED_UP, MetaAction.CRUISE, MetaAction.SLOW_DOWN)

likings = st.just(EAGER) | st.permutations(range(5))
speeds, accels = st.floats(0, 28), st.floats(-3, 3)

every_preset = pytest.mark.parametrize("preset", sorted(PRESETS))

either_side = pytest.mark.parametrize("side", [MetaAction.LEFT, MetaAction.RIGHT], ids=["left", "right"])


def in_lane(lane: int, v: float, accel: float = 0.0, x: float = 500.0, extra: float = 0.0) -> Ego:
    return Ego(x, 4.0 * lane, v, 0.0, accel, max(v + extra, 0.0), lane, -1)
