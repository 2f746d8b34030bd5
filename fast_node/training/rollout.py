"""Many scenes of one scenario behind the mask, compiled: for learning and for evaluating. The world comes in as an
object, never an import.

Axes: S scenes, V vehicles, L lanes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fast_node import choice, mask
from fast_node.choice import MASKED
from fast_node.mask.vocabulary import LEFT, RIGHT
from fast_node.training.tracking import FleetTracks, Sense
from schemas.driving.episode import REDIRECT_PER_S, Decision, Ending, Goal, closeness, ending, flags, held, replaced
from schemas.driving.features import FEATURES, N_ROWS, Array, policy_input
from schemas.driving.intent import ANY_LANE, NORMAL, intended_lane, unasked_lane
from schemas.driving.measures import TTC_CAP_S
from schemas.driving.reward import OURS, Weights
from schemas.driving.road import DECISION_TICKS, HZ, LANE_END, LANE_OPENS, LANE_WAY, LANE_Y, VX, X
from schemas.runtime.compiled import compiled
from schemas.wire.messages import POLICY_ACTIONS, MetaAction

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def _look_all(
    rows: Any,
    lanes: Any,
    target_speed: Any,
    target_lane: Any,
    previous: Any,
    accel: Any,
    sight: float,
    preset: mask.Preset,
    told_lane: Any,
    pass_id: Any,
    v_des: Any,
    headway: Any,
    style: Any,
    masked: bool,
    obeyed: bool,
    near: Any,
    rule: Any,
    vehicle: Any,
    wish_lane: Any,
    fresh: Any,
    left: Any,
    cap: Any,
    ttc: Any,
    short: Any,
) -> None:
    """Of every scene: what the mask and the intent close, the speed cap, the lane wished now, the time to collision
    and the shortfall of the gap.

    near, rule, vehicle, wish_lane, left, cap, ttc, short: outputs; fresh (S,): whether a tick has passed; the rest as
    `Fleet` has it.
    """
    for s in range(rows.shape[0]):
        safe = mask.close_actions(
            rows[s], lanes[s], target_speed[s], target_lane[s], previous[s], sight, near[s], rule[s], vehicle[s], preset
        )
        if not masked:
            rule[s] = mask.OPEN
            safe = np.inf
        if pass_id[s] >= 0:
            wish_lane[s] = intended_lane(rows[s], told_lane[s], pass_id[s])
        else:
            wish_lane[s] = (
                told_lane[s]
                if told_lane[s] >= 0
                else unasked_lane(lanes[s], target_lane[s], previous[s], rows[s, 0, X], rows[s, 0, VX])
            )
        if fresh[s]:
            left[s, 0], left[s, 1] = choice.hold_off(left[s, 0], left[s, 1], target_lane[s], previous[s])
        cap[s] = safe
        if obeyed:
            wished = choice.comfortable_mps(
                rows[s], near[s], lanes[s], target_lane[s], accel[s], v_des[s], headway[s], style[s]
            )
            cap[s] = min(safe, wished)
            choice.narrow(
                rule[s],
                rows[s],
                near[s],
                lanes[s],
                target_speed[s],
                target_lane[s],
                previous[s],
                left[s, 0] if left[s, 1] > 0 else -1,
                wish_lane[s],
                v_des[s],
                headway[s],
                cap[s],
            )
        ttc[s], short[s] = closeness(rows[s], target_lane[s], headway[s])


def _observe_all(
    rows: Any,
    lanes: Any,
    wish_lane: Any,
    v_des: Any,
    headway: Any,
    target_speed: Any,
    target_lane: Any,
    previous: Any,
    cap: Any,
    rule: Any,
    goal_x: float,
    order: Any,
    out: Any,
) -> None:
    """Fill `out` (S, N, F), which comes zeroed, with every scene's policy input; order: working space."""
    for s in range(rows.shape[0]):
        aim, own, x = max(wish_lane[s], 0), target_lane[s], rows[s, 0, X]
        y_des = np.nan if wish_lane[s] < 0 else lanes[s, aim, LANE_Y]
        policy_input(
            rows[s],
            y_des,
            v_des[s],
            headway[s],
            target_speed[s],
            previous[s] >= 0,
            lanes[s, own, LANE_END] - x,
            cap[s],
            rule[s, LEFT] == mask.OPEN,
            rule[s, RIGHT] == mask.OPEN,
            own,
            aim,
            lanes[s, own, LANE_OPENS] - x,
            lanes[s, aim, LANE_END] - x,
            goal_x - x,
            min(lanes[s, own, LANE_WAY], lanes[s, aim, LANE_WAY]) < 0,
            order,
            out[s],
        )


def _choose_all(logits: Any, rule: Any, age: Any, holding: Any, meta: Any, by: Any) -> None:
    """Fill meta (S,) and by (S,) with every scene's `choice.choose`; a decision is due where `age` (S,) has come to
    `DECISION_TICKS`. holding (S,): what the last decision asks for meanwhile, replaced where one is made."""
    for s in range(len(meta)):
        due = age[s] >= DECISION_TICKS
        meta[s], by[s] = choice.choose(logits[s], rule[s], due, holding[s])
        if due:
            holding[s], age[s] = held(meta[s]), 0
        age[s] += 1


_look = compiled(_look_all)
_observe = compiled(_observe_all)
_choose = compiled(_choose_all)


class World(Protocol):
    """A batched simulator (see `sim_node.engine.batched`): arrays over S scenes, and a 15 Hz tick."""

    rows: Array
    lane_y: Floats
    target_speed: Floats
    target_lane: Ints
    previous_lane: Ints
    accel: Floats
    crashed: Bools
    ticks: Ints
    """(S,) of the episode so far."""

    def tick(self, meta: Ints, speed_goal: Floats, speed_cap: Floats, style: Ints, /) -> None: ...

    def reset(self, mask: Bools) -> None: ...

    def copy(self, other: Any, scenes: Ints) -> None: ...


@dataclass(frozen=True)
class Task:
    """What the simulator's side of a scenario looks like from here; `deploy` fills it in."""

    name: str
    lanes: Floats
    """(L, 8) as `mask.lane_table`, at x = 0."""
    sight_m: float
    speed_range: float
    duration_ticks: int
    goal: Goal
    draw: Callable[[np.random.Generator, Array, int], tuple[int, int, float, float]]
    """A random directive for rows (V, 9) and a home lane: lane, id of the car to pass or -1, speed, headway."""
    preset: str = "sim"
    """Of the mask."""
    weights: Weights = OURS
    """Of the reward."""


class Fleet:
    """S scenes of one task: what each ego sees, is asked for and may do now.

    Not `masked`: anything, always. Not `obeyed`: a wish closes nothing; behind the mask it does, unless told otherwise.
    `sense`: what its sensors make of a scene; None: they see it as it is.
    """

    def __init__(
        self, world: World, task: Task, *, masked: bool = True, obeyed: bool | None = None, sense: Sense | None = None
    ) -> None:
        self.world, self.task, self.masked = world, task, masked
        self._obeyed = masked if obeyed is None else obeyed
        self._preset = mask.PRESETS[task.preset]
        s, n = len(world.rows), len(task.lanes)
        self.lanes = np.repeat(task.lanes[None], s, axis=0)
        self.rule, self.vehicle = np.zeros((s, len(MetaAction)), np.int64), np.zeros((s, len(MetaAction)), np.int64)
        self._tracks = FleetTracks(world.rows, sense)
        self._rows = self._tracks.rows
        self._near = np.zeros((s, 3 * n), np.int64)
        self._order = np.zeros(world.rows.shape[1], np.int64)
        self.told_lane, self.pass_id = np.full(s, ANY_LANE), np.full(s, -1)
        self.v_des, self.headway = np.zeros(s), np.full(s, 1.5)
        self.wish = np.full(s, ANY_LANE)
        self.left = np.zeros((s, 2), np.int64)
        self.cap_mps = np.full(s, np.inf)
        self.style = np.full(s, NORMAL)
        self.ttc_s, self.short = np.full(s, TTC_CAP_S), np.zeros(s)

    def look(self) -> None:
        """Mask, wishes and time to collision of the present state."""
        w = self.world
        self.lanes[:, :, LANE_Y] = w.lane_y
        fresh = self._tracks.follow(w.rows, w.ticks, self.lanes, self.task.sight_m)
        _look(
            self._rows,
            self.lanes,
            w.target_speed,
            w.target_lane,
            w.previous_lane,
            w.accel,
            self.task.sight_m,
            self._preset,
            self.told_lane,
            self.pass_id,
            self.v_des,
            self.headway,
            self.style,
            self.masked,
            self._obeyed,
            self._near,
            self.rule,
            self.vehicle,
            self.wish,
            fresh,
            self.left,
            self.cap_mps,
            self.ttc_s,
            self.short,
        )

    def observe(self) -> Array:
        """Policy input (S, N, F) of what `look` saw last."""
        w = self.world
        out = np.zeros((len(self.wish), N_ROWS, len(FEATURES)), np.float32)
        _observe(
            self._rows,
            self.lanes,
            self.wish,
            self.v_des,
            self.headway,
            w.target_speed,
            w.target_lane,
            w.previous_lane,
            self.cap_mps,
            self.rule,
            self.task.goal.end_x_m,
            self._order,
            out,
        )
        return out

    def over(self) -> Bools:
        """Where the ego has crashed, reached its goal or come to the road's end."""
        return np.asarray(ending(self.world.crashed, self.world.rows[:, 0], self.task.goal) != Ending.NONE)


class Scenes(Fleet):
    """A fleet with random directives, stepped one decision at a time: what the learner learns in."""

    def __init__(
        self,
        world: World,
        task: Task,
        seed: int,
        decision_ticks: int = DECISION_TICKS,
        *,
        masked: bool = True,
        obeyed: bool | None = None,
        sense: Sense | None = None,
    ) -> None:
        super().__init__(world, task, masked=masked, obeyed=obeyed, sense=sense)
        self._rng = np.random.default_rng(seed)
        self._decision_ticks = decision_ticks
        s = len(world.rows)
        self.age = np.zeros(s, np.int64)
        self.returns = np.zeros(s)
        self._holding = np.full(s, int(MetaAction.CRUISE))
        self._meta, self._by = np.zeros(s, np.int64), np.zeros(s, np.int64)
        self.reset(np.ones(s, np.bool_))

    def reset(self, which: Bools) -> None:
        """New scenes where told; a directive is drawn for each, and again now and then during the episode."""
        self.world.reset(which)
        self._tracks.forget(which)
        self.left[which] = 0
        self.age[which], self.returns[which] = 0, 0.0
        self._direct(which)
        self.look()

    def _direct(self, which: Bools) -> None:
        for s in np.flatnonzero(which):
            self.told_lane[s], self.pass_id[s], self.v_des[s], self.headway[s] = self.task.draw(
                self._rng, self.world.rows[s], int(self.world.target_lane[s])
            )

    def become(self, other: Scenes, which: Ints) -> None:
        """Go on from where scenes `which` (S,) of another of the same task are: to try what may come of them."""
        self.world.copy(other.world, which)
        self._tracks.become(other._tracks, which)
        for name in (
            "left", "told_lane", "pass_id", "v_des", "headway", "style", "age", "returns",
            "_holding", "rule", "vehicle", "wish", "cap_mps", "ttc_s", "short", "_near", "lanes",
        ):  # fmt: skip
            getattr(self, name)[:] = getattr(other, name)[which]

    def open(self) -> Bools:
        """(S, 5) the actions that the mask leaves open."""
        return np.asarray(self.rule[:, :POLICY_ACTIONS] == mask.OPEN)

    def decide(self, action: Ints, *, redirect: bool = True) -> tuple[NDArray[np.float32], Bools, Bools]:
        """One decision: the action first, then held unless the mask closes that: reward, terminated, truncated.

        redirect: now and then another directive follows.
        """
        w = self.world
        s = len(action)
        first = np.minimum(replaced(action, self.rule == mask.OPEN), POLICY_ACTIONS - 1)  # all closed: it brakes anyway
        logits = np.eye(POLICY_ACTIONS, dtype=np.float32)[first]
        since = np.full(s, DECISION_TICKS)
        decision = Decision(action, w.rows[:, 0, X], w.accel)
        for k in range(self._decision_ticks):
            if k:
                since[:] = 0
            _choose(logits, self.rule, since, self._holding, self._meta, self._by)
            w.tick(self._meta, self.v_des, self.cap_mps, self.style)
            self.look()
            there = (self.wish == ANY_LANE) | (w.target_lane == self.wish)
            over = ending(w.crashed, w.rows[:, 0], self.task.goal)
            decision.tick(self._meta, w.rows[:, 0], w.accel, self.ttc_s, self.short, there, over)
        self.age += 1
        earned = decision.earned(
            self.v_des, self.task.speed_range, to_reach=bool(self.task.goal.reach_lanes), weights=self.task.weights
        )
        terminated, truncated = flags(decision.over, self.age * self._decision_ticks >= self.task.duration_ticks)
        again = redirect & (self._rng.random(s) < REDIRECT_PER_S * self._decision_ticks / HZ) & ~terminated & ~truncated
        if again.any():
            self._direct(again)
            self.look()
        self.returns += earned
        return earned, terminated, truncated


class Driver:
    """Drives a fleet at 15 Hz exactly as the fast node does: the same mask, wishes, features and choice."""

    def __init__(self, fleet: Fleet, logits: Callable[[Array], Array], *, stateless: bool = False) -> None:
        """stateless: to ask only where a decision is due makes no difference, and saves four of five questions."""
        self.fleet, self._logits, self._stateless = fleet, logits, stateless
        s = len(fleet.wish)
        self._preferred = np.zeros((s, POLICY_ACTIONS), np.float32)
        self._age = np.full(s, DECISION_TICKS)
        self._holding = np.full(s, int(MetaAction.CRUISE))
        self.meta, self.by = np.zeros(s, np.int64), np.zeros(s, np.int64)
        self.overridden = np.zeros(s, np.bool_)

    def tick(self) -> None:
        """Look, choose, and advance every scene by one tick."""
        f, w = self.fleet, self.fleet.world
        f.look()
        if not self._stateless or (self._age >= DECISION_TICKS).any():
            self._preferred = self._logits(f.observe())
        _choose(self._preferred, f.rule, self._age, self._holding, self.meta, self.by)
        self.overridden = self.by == MASKED
        w.tick(self.meta, f.v_des, f.cap_mps, f.style)
