"""Episodes of many scenes at once, at 15 Hz: a scenario's traffic and wish of a seed, who drives, what is measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from fast_node.coordination import ASSERTIVE_HEADWAY_S
from fast_node.mask import OPEN
from fast_node.training.rollout import Driver, Fleet, Task
from schemas.driving.intent import ANY_LANE
from schemas.driving.road import AGAINST_MPS, DECISION_TICKS, HZ, ID, LANE, NOBODY, VX, X, lane_table, next_ahead
from schemas.wire.messages import MetaAction
from sim_node.engine.batched import Batched
from sim_node.metrics import EpisodeResult, Recorder
from sim_node.scenarios import Scenario
from sim_node.scenarios.scenario import draw_wish, streams

FIRST_SEED = 1000
"""Evaluation seeds are 1000, 1001, ...; training draws its scenes from generators that are seeded otherwise."""
Directive = Literal["hurry", "lane", "random"]
"""What the passenger asks for: full speed in any lane (on two-way: to overtake, one car after the other), full speed in
a lane drawn for the seed, or any lane and any speed drawn for the seed."""
DIRECTIVES: tuple[Directive, ...] = get_args(Directive)
Logits = Callable[[NDArray[np.float32]], NDArray[np.float32]]
Step = Callable[[int], NDArray[np.bool_]]
"""Advances a fleet at a tick, counted from 0, and says in which scenes the mask decided against the driver."""


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
        draw=lambda rng, rows, home: draw_wish(rng, scenario, rows, home),
        preset=preset,
    )


def directed(
    directive: Directive, scenario: Scenario, rng: np.random.Generator, rows: Any, home: int
) -> tuple[int, int, float, float]:
    """A directive for rows (V, 9) and a home lane, drawn as `draw_wish` draws and of the same form."""
    lane, pass_id, speed_mps, headway_s = draw_wish(rng, scenario, rows, home, overtake_share=1.0)
    if directive == "random":
        return lane, pass_id, speed_mps, headway_s
    if directive == "hurry" and scenario.wish_lanes:
        lane = ANY_LANE
    return lane, pass_id, scenario.ego.speed_ceiling_mps, ASSERTIVE_HEADWAY_S


def load(fleet: Fleet, scenario: Scenario, scene: int, seed: int, directive: Directive) -> None:
    """Put that seed's traffic and directive into one scene of a fleet of `Batched` scenes."""
    world = fleet.world
    assert isinstance(world, Batched)
    traffic, wishes, _ = streams(seed)
    world.load(scene, scenario.spawn(traffic))
    fleet.told_lane[scene], fleet.pass_id[scene], fleet.v_des[scene], fleet.headway[scene] = directed(
        directive, scenario, wishes, world.rows[scene], int(world.target_lane[scene])
    )


def record(fleet: Fleet, scenario: Scenario, step: Callable[[int], NDArray[np.bool_] | None]) -> list[EpisodeResult]:
    """Drive every scene of a fleet to its end with a `Step`, and measure it."""
    w = fleet.world
    recorder, active = Recorder(scenario, len(fleet.wish)), np.ones(len(fleet.wish), np.bool_)
    for tick in range(round(scenario.duration_s * HZ)):
        lane, held = w.target_lane.copy(), w.previous_lane < 0
        overridden = step(tick)
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
            overridden,
            way_open,
        )
        active &= ~fleet.over()
        if not active.any():
            break
    return recorder.results()


def way_is_open(fleet: Fleet, lane: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(S,) where the change from `lane` towards the wished lane was open when the fleet looked last; without a mask:
    where another lane is wished."""
    side = np.where(fleet.wish < lane, int(MetaAction.LEFT), int(MetaAction.RIGHT))
    is_open = fleet.rule[np.arange(len(lane)), side] == OPEN
    return np.asarray((fleet.wish != ANY_LANE) & (fleet.wish != lane) & is_open)


def by_the_tick(fleet: Fleet, logits: Logits) -> Step:
    """As the fast node drives: it looks, and may decide, at every tick."""
    driver = Driver(fleet, logits)

    def step(tick: int) -> NDArray[np.bool_]:
        driver.tick()
        return driver.overridden

    return step


def by_the_second(fleet: Fleet, logits: Logits) -> Step:
    """As one that knows no mask has learnt to: a decision a second, held in between."""
    hold = np.full(len(fleet.wish), int(MetaAction.CRUISE))
    return unasked(fleet, lambda tick: logits(fleet.observe()).argmax(-1) if tick % DECISION_TICKS == 0 else hold)


def unasked(fleet: Fleet, act: Callable[[int], NDArray[np.int64]]) -> Step:
    """Actions as they come, with nobody to decide against them."""
    never = np.zeros(len(fleet.wish), np.bool_)

    def step(tick: int) -> NDArray[np.bool_]:
        fleet.look()
        fleet.world.tick(act(tick), fleet.v_des)
        return never

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
