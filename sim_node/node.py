"""The simulator without its process: one tick from an action to an observation, no clock and no bus."""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from schemas.driving.episode import Ending
from schemas.driving.measures import TTC_CAP_S
from schemas.driving.road import HZ, LANE
from schemas.wire.messages import Action, Control, Event, EventKind, MetaAction, Observation
from sim_node.actuator import REASONS
from sim_node.config import SimConfig
from sim_node.env import ScenarioEnv
from sim_node.gate import answers
from sim_node.metrics import Recorder
from sim_node.mode import ModeKeeper
from sim_node.sumo.env import SumoEnv

HOLD_TICKS = 2
"""Without an answer, the set-points hold for this many ticks; from the next one on the ego brakes."""
FAILSAFE_BRAKE_MPS2 = 2.5
_SAID = {Ending.COLLISION: "collision", Ending.GOAL: "goal reached", Ending.ROAD_END: "road end"}
_YES = np.ones(1, np.bool_)


@dataclass
class Metrics:
    """Counts since the start, over all episodes."""

    ticks: int = 0
    answered: int = 0
    """Ticks that applied an action."""
    holds: int = 0
    """Ticks without an action that held the set-points."""
    failsafes: int = 0
    """Ticks without an action that braked."""
    refused: int = 0
    """Ticks in which the actuator did not carry out what was asked for."""
    episodes: int = 0
    collisions: int = 0
    struck: int = 0
    """Collisions that were the other car's fault."""
    passed: int = 0
    """Episodes in which the ego passed the first lead and came back to its lane."""
    reached: int = 0
    """Episodes in which the ego reached the place that the scenario names."""
    min_ttc_s: float = TTC_CAP_S
    """Smallest time to collision with a car ahead in the ego's lane or its target lane."""


class SimNode:
    """The world between two messages: an observation, the action that answers it, the next observation.

    `step` never waits. Without an answer the set-points hold for `HOLD_TICKS` ticks in a row, and so does a lane change
    that has begun; then the ego brakes gently in its target lane until the next answer.
    """

    def __init__(self, config: SimConfig) -> None:
        self._events: list[Event] = []
        self.metrics = Metrics()
        self.build(config)
        self.epoch = 0
        self.tick = 0
        self.over = ""
        """Why the episode has ended; empty while it runs."""
        self._applied_tick = -1
        self._unanswered = 0
        self.mode = ModeKeeper()

    def build(self, config: SimConfig) -> None:
        """Take another road, or other traffic on it; the next `reset` begins there, with the configuration's seed."""
        self._config = config
        self._first = self.metrics.episodes
        kind = SumoEnv if config.sim == "sumo" else ScenarioEnv
        self._env = kind(
            config.road(),
            hz=config.hz,
            decision_hz=config.hz,
            duration_s=None,
            noise_m=config.noise_m,
            noise_mps=config.noise_mps,
            dropout=config.dropout,
            checked=True,
        )
        self._recorder = Recorder(self._env.scenario, 1, config.hz)

    def restart(self, order: Control, now_ns: int) -> None:
        """Begin the next world at once, as the order says: another road, seed or density, or what there is now.

        Raises ValueError if there is no such road, seed or density; then nothing has changed.
        """
        config, scenario = self._config, order.scenario
        config = msgspec.structs.replace(
            config,
            seed=config.seed if order.seed is None else order.seed,
            density=config.density if order.density is None else order.density,
        )
        if scenario not in ("", config.scenario):
            config = msgspec.structs.replace(config, scenario=scenario, scenario_toml="")
        self.build(config)
        self.reset(self.epoch + 1)
        self.announce("as ordered", now_ns)

    @property
    def speed_mps(self) -> float:
        """The ego's speed."""
        return float(self._env.ego.speed)

    @property
    def lane(self) -> int:
        """The lane the ego's centre is in."""
        return int(self._rows[0, LANE])

    @property
    def seed(self) -> int:
        """Of this episode."""
        return self._config.seed + self.metrics.episodes - self._first - 1

    @property
    def density(self) -> float:
        """Times the scenario's own."""
        return self._config.density

    def reset(self, epoch: int) -> None:
        """Begin the next episode as world `epoch`, at tick 0, with the next seed."""
        self._env.reset(seed=self._config.seed + self.metrics.episodes - self._first)
        self.metrics.episodes += 1
        self.epoch, self.tick, self.over = epoch, 0, ""
        self._applied_tick, self._unanswered, self._told_tick = -1, 0, -HZ
        self._recorder.restart(_YES)
        self._rows = self._env.rows()

    def announce(self, why: str, now_ns: int) -> None:
        """Note the event that this world has begun, and why."""
        detail = f"new world {why}, seed {self.seed}"
        if self.density != 1.0:
            detail += f", density {self.density:g}"
        self._events.append(
            Event(epoch=self.epoch, stamp_ns=now_ns, kind=EventKind.WORLD, node="sim", tick=0, detail=detail)
        )

    def step(self, action: Action | None, now_ns: int) -> Observation:
        """Advance one tick and observe."""
        self.advance(action, now_ns)
        return self.observation(now_ns)

    def advance(self, action: Action | None, now_ns: int) -> None:
        """Step the world by one tick with the action, if it answers the present observation.

        At an episode's end, no action is applied: the next epoch begins.
        """
        self.metrics.ticks += 1
        if self.over:
            why = self.over
            self.reset(self.epoch + 1)
            self.announce(f"after {why}", now_ns)
            return
        ego = self._env.ego
        ego.speed_goal = math.nan
        meta = MetaAction.CRUISE
        if action is not None and not answers(action, self.epoch, self.tick):
            action = None
        if action is not None:
            meta = MetaAction(action.meta_action)
            if action.speed_goal_mps is not None:
                ego.speed_goal = action.speed_goal_mps
            ego.speed_cap = math.inf if action.speed_cap_mps is None else action.speed_cap_mps
            ego.style = action.style
            self._applied_tick = action.answers_tick
            self._unanswered = 0
            self.metrics.answered += 1
        else:
            self._unanswered += 1
            if self._unanswered <= HOLD_TICKS:
                self.metrics.holds += 1
            else:
                self.metrics.failsafes += 1
                # The executor brakes with its gain times this difference: a gentle, jerk-bounded stop in lane.
                ego.target_speed = max(0.0, float(ego.speed) - FAILSAFE_BRAKE_MPS2)
        self.mode.tick(action, self._unanswered > HOLD_TICKS, float(ego.speed), now_ns)
        self._env.tick(int(meta))
        self._tell_of_the_actuator(meta, now_ns)
        self.tick += 1
        self._rows = self._env.rows()
        self._measure()

    def _tell_of_the_actuator(self, asked: MetaAction, now_ns: int) -> None:
        """Count what the actuator has not carried out; an event a second at most."""
        why, vehicle = self._env.refused
        if not why:
            return
        self.metrics.refused += 1
        if self.tick - self._told_tick < HZ:
            return
        self._told_tick = self.tick
        detail = f"{asked.name.lower().replace('_', ' ')} is not carried out: {REASONS[why]}"
        self._events.append(
            Event(
                epoch=self.epoch,
                stamp_ns=now_ns,
                kind=EventKind.ACTUATOR,
                node="sim",
                tick=self.tick,
                vehicle=vehicle,
                detail=detail,
            )
        )

    def observation(self, now_ns: int) -> Observation:
        """What the ego sees at the current tick."""
        return self._env.seen_at(self.epoch, self.tick, now_ns, self._applied_tick)

    def take_events(self) -> list[Event]:
        """Events since the last call."""
        taken, self._events = self._events, []
        return taken

    def _measure(self) -> None:
        env, ego, m = self._env, self._env.ego, self.metrics
        before = bool(self._recorder.passed[0])
        self._recorder.tick(
            self._rows[None],
            np.array([ego.acceleration]),
            np.array([ego.target_lane]),
            np.array([ego.previous_lane]),
            np.array([bool(ego.crashed)]),
            _YES,
        )
        m.passed += bool(self._recorder.passed[0]) and not before
        m.min_ttc_s = min(m.min_ttc_s, float(self._recorder.min_ttc[0]))
        over = env.ending()
        self.over = _SAID.get(over, "")
        m.collisions += over == Ending.COLLISION
        m.struck += over == Ending.COLLISION and bool(self._recorder.struck[0])
        m.reached += over == Ending.GOAL
