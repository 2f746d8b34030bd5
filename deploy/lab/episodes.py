"""Episodes of many scenes at once, at 15 Hz: a scenario's traffic and wish of a seed, who drives, what is measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from fast_node.choice import HELD, MASKED, WISHED
from fast_node.config import FastConfig
from fast_node.coordination import ASSERTIVE_HEADWAY_S
from fast_node.mask import OPEN
from fast_node.training.rollout import Driver, Fleet, Task
from schemas.driving.features import Array
from schemas.driving.intent import ANY_LANE, ASSERTIVE
from schemas.driving.road import (
    AGAINST_MPS,
    DECISION_TICKS,
    HZ,
    ID,
    LANE,
    NOBODY,
    VX,
    X,
    Y,
    home_lane,
    lane_table,
    next_ahead,
)
from schemas.runtime.clock import NS
from schemas.wire.messages import POLICY_ACTIONS, MetaAction, Observation
from sim_node.engine.batched import Batched
from sim_node.metrics import Recorder, Settled
from sim_node.results import EpisodeResult
from sim_node.scenarios import Scenario
from sim_node.scenarios.scenario import draw_wish, streams

FIRST_SEED = 1000
"""Evaluation seeds are 1000, 1001, ...; training draws its scenes from generators that are seeded otherwise."""
Directive = Literal["hurry", "lane", "random"]
"""What the passenger asks for: full speed in any lane (on two-way: to overtake, one car after the other), full speed in
a lane drawn for the seed, or any lane and any speed drawn for the seed."""
DIRECTIVES: tuple[Directive, ...] = get_args(Directive)
Logits = Callable[[NDArray[np.float32]], NDArray[np.float32]]
Step = Callable[[int], Settled | None]
"""Advances a fleet at a tick, counted from 0, and says how its actions came about; None: nobody decides."""
Watch = Callable[[Fleet, Driver | None, Step], Step]
"""The same step, but somebody looks on. No driver: nobody decides."""
WORDLESS_HEADWAY_S = FastConfig().default_headway_s


def task_of(scenario: Scenario, preset: str = "sim") -> Task:
    """The scenario as the fast system's training and evaluation see it, behind a mask with this preset."""
    ceiling = scenario.ego.speed_ceiling_mps
    return Task(
        name=scenario.name,
        lanes=np.array(lane_table(scenario.lanes_at(0.0))),
        sight_m=scenario.sight_m,
        speed_range=0.5 * ceiling,
        duration_ticks=round(scenario.duration_s * HZ),
        goal=scenario.goal,
        draw=partial(draw_wish, scenario),
        preset=preset,
    )


def directed(
    directive: Directive, scenario: Scenario, rng: np.random.Generator, rows: Any, home: int
) -> tuple[int, int, float, float]:
    """A directive for rows (V, 9) and a home lane, drawn as `draw_wish` draws and of the same form."""
    lane, pass_id, speed_mps, headway_s = draw_wish(scenario, rng, rows, home, overtake_share=1.0)
    if directive == "random":
        return lane, pass_id, speed_mps, headway_s
    if directive == "hurry" and len(scenario.wish_lanes) > 1:
        lane = ANY_LANE
    return lane, pass_id, scenario.ego.speed_ceiling_mps, ASSERTIVE_HEADWAY_S


def load(fleet: Fleet, scenario: Scenario, scene: int, seed: int, directive: Directive) -> None:
    """Put that seed's traffic and directive into one scene of a fleet of `Batched` scenes."""
    world = fleet.world
    assert isinstance(world, Batched)
    world.load(scene, scenario.spawn(streams(seed)[0]))
    direct(fleet, scenario, scene, seed, directive)


def direct(fleet: Fleet, scenario: Scenario, scene: int, seed: int, directive: Directive) -> None:
    """Give the ego of one scene that seed's directive, for what is on the road now."""
    world = fleet.world
    home = home_lane(fleet.lanes[scene], int(world.target_lane[scene]))
    fleet.told_lane[scene], fleet.pass_id[scene], fleet.v_des[scene], fleet.headway[scene] = directed(
        directive, scenario, streams(seed)[1], world.rows[scene], home
    )


class Words:
    """When each scene's directive comes. Until then the ego drives without words, as the fast node does: at the
    speed with which it began."""

    def __init__(
        self,
        fleet: Fleet,
        scenario: Scenario,
        seeds: Sequence[int],
        directive: Directive,
        at_s: float = 0.0,
        wish_mps: float | None = None,
    ) -> None:
        self._fleet, self._scenario, self._seeds, self._directive = fleet, scenario, seeds, directive
        self._at_tick, self._wish_mps = round(at_s * HZ), wish_mps
        fleet.v_des[:] = np.round(fleet.world.target_speed)

    def at(self, tick: int) -> bool:
        """Say what is to be said at this tick; whether the directive has been given by now."""
        fleet = self._fleet
        if tick < self._at_tick:
            fleet.pass_id[:], fleet.headway[:] = NOBODY, WORDLESS_HEADWAY_S
            fleet.told_lane[:] = ANY_LANE
        elif tick == self._at_tick:
            for s, seed in enumerate(self._seeds):
                direct(fleet, self._scenario, s, seed, self._directive)
            if self._wish_mps is not None:
                fleet.v_des[:] = self._wish_mps
        return tick >= self._at_tick


def published(scenario: Scenario, tick: int, rows: Array, **fields: Any) -> Observation:
    """A scene's rows (V, 9) of a batch as the ego is shown them; fields: the rest of an `Observation`."""
    return Observation(
        epoch=0,
        stamp_ns=tick * NS // HZ,
        tick=tick,
        scenario=scenario.name,
        lanes=scenario.lanes_at(float(rows[0, X])),
        rows=rows[rows[:, ID] >= 0].tobytes(),
        sight_m=scenario.sight_m,
        **fields,
    )


def record(fleet: Fleet, scenario: Scenario, step: Step, words: Words | None = None) -> list[EpisodeResult]:
    """Drive every scene of a fleet to its end with a `Step`, and measure it. words: None: they have been said."""
    w = fleet.world
    recorder, active = Recorder(scenario, len(fleet.wish)), np.ones(len(fleet.wish), np.bool_)
    refused = np.zeros(len(fleet.wish), np.int64)
    for tick in range(round(scenario.duration_s * HZ)):
        told = words is None or words.at(tick)
        lane, held = w.target_lane.copy(), w.previous_lane < 0
        settled = step(tick)
        if isinstance(w, Batched):
            refused += active & (w.refused != 0)
        way_open = held & way_is_open(fleet, lane)
        if tick % DECISION_TICKS == 0 and not scenario.wish_lanes:
            overtake_on(fleet)
        recorder.tick(
            w.rows,
            w.accel,
            w.target_lane,
            w.previous_lane,
            w.crashed,
            active,
            fleet.wish,
            fleet.v_des,
            None if settled is None else settled.by_mask,
            way_open,
            wish_headway=fleet.headway,
            pass_id=fleet.pass_id,
            asked=np.full(len(active), told),
            settled=settled,
        )
        active &= ~fleet.over()
        if not active.any():
            break
    return [replace(r, actuator_ticks=int(n)) for r, n in zip(recorder.results(), refused, strict=True)]


def way_is_open(fleet: Fleet, lane: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(S,) where the change from `lane` towards the wished lane was open when the fleet looked last; without a mask:
    where another lane is wished."""
    side = np.where(fleet.wish < lane, int(MetaAction.LEFT), int(MetaAction.RIGHT))
    is_open = fleet.rule[np.arange(len(lane)), side] == OPEN
    return np.asarray((fleet.wish != ANY_LANE) & (fleet.wish != lane) & is_open)


def by_the_tick(driver: Driver) -> Step:
    """As the fast node drives: it looks, and may decide, at every tick."""

    def step(tick: int) -> Settled:
        driver.tick()
        by = driver.by
        return Settled(by != HELD, has_choice(driver.fleet), by == MASKED, by == WISHED)

    return step


def has_choice(fleet: Fleet) -> NDArray[np.bool_]:
    """(S,) where two or more of the policy's actions were open when the fleet looked last."""
    return np.asarray((fleet.rule[:, :POLICY_ACTIONS] == OPEN).sum(axis=1) > 1)


def always(fleet: Fleet, action: MetaAction) -> Step:
    """One action at every tick, whatever happens: nobody decides."""
    actions = np.full(len(fleet.wish), int(action))

    def step(tick: int) -> None:
        fleet.look()
        fleet.world.tick(actions, fleet.v_des, fleet.cap_mps, fleet.style)

    return step


def reckless(fleet: Fleet) -> Step:
    """The worst that an action can ask for: into the lane of the nearest car, and as fast as the car goes."""
    world, style = fleet.world, np.full(len(fleet.wish), ASSERTIVE)
    fastest = np.full(len(fleet.wish), np.inf)

    def step(tick: int) -> None:
        fleet.look()
        rows = world.rows
        away = np.where(
            rows[:, 1:, ID] >= 0, np.hypot(rows[:, 1:, X] - rows[:, :1, X], rows[:, 1:, Y] - rows[:, :1, Y]), np.inf
        )
        nearest = rows[np.arange(len(rows)), 1 + away.argmin(axis=1)]
        aside = nearest[:, LANE].astype(np.int64) - world.target_lane
        there = np.isfinite(away.min(axis=1)) & (world.previous_lane < 0)
        action = np.select(
            (there & (aside < 0), there & (aside > 0)),
            (int(MetaAction.LEFT), int(MetaAction.RIGHT)),
            int(MetaAction.SPEED_UP),
        )
        world.tick(action, fastest, fastest, style)

    return step


def overtake_on(fleet: Fleet) -> None:
    """Whoever has left its car behind is asked to pass the next, as the slow node asks while the passenger is in a
    hurry. Its car counts as left behind once the ego's centre is past it, not once there is room to move in."""
    for s in np.flatnonzero(fleet.pass_id >= 0):
        rows, lane = fleet.world.rows[s], int(fleet.told_lane[s])
        ours = (rows[:, LANE] == lane) & (rows[:, VX] >= AGAINST_MPS)
        still_ahead = ours & (rows[:, ID] == fleet.pass_id[s]) & (rows[:, X] > rows[0, X])
        following = next_ahead(rows, lane, float(rows[0, X]))
        if following != NOBODY and not still_ahead.any():
            fleet.pass_id[s] = int(rows[following, ID])
