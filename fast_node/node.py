"""The fast node: one action for every observation, whatever fails. Pure: no sockets, sleeps or clocks in here."""

from __future__ import annotations

import math
from typing import NamedTuple

from fast_node.choice import SOURCES, choose, comfortable_mps, hold_off, narrow
from fast_node.config import FastConfig
from fast_node.coordination import Coordination
from fast_node.mask import OPEN, PRESETS, Preset, close_actions
from fast_node.policies.policy import Policy
from fast_node.tracks import Tracks
from schemas.driving.episode import MILDEST, held
from schemas.driving.features import Array, features
from schemas.driving.intent import ANY_LANE, Intent
from schemas.driving.road import LANE_END, LANE_OPENS, LANE_WAY, LANE_Y, NOBODY, X, lane_table
from schemas.wire.codec import rows_of
from schemas.wire.messages import POLICY_ACTIONS, Action, Closure, Directive, Event, MetaAction, Observation, Reason

_REASONS = tuple(Reason)
"""By the mask's number less one."""
Table = list[list[float]]
"""(V, 9), as `Observation.rows`, of the tracks."""
Lanes = list[tuple[float, ...]]
"""As `lane_table` has them."""


class Choice(NamedTuple):
    """What is done at a tick, and who has chosen it."""

    meta: int
    source: str
    why: str = ""
    """What has failed."""
    probabilities: tuple[float, ...] = ()


class FastNode:
    """`step` turns an observation and the newest directive into an action and events."""

    def __init__(
        self, config: FastConfig, policy: Policy, preset: Preset = PRESETS["sim"], *, stateless: bool = False
    ) -> None:
        """preset: of the mask; the one that the policy was trained behind. stateless: to ask the policy only where a
        decision is due makes no difference, and saves four of five questions."""
        self._config, self._policy, self._preset, self._stateless = config, policy, preset, stateless
        self._tracks = Tracks()
        self._coordination = Coordination(config.default_headway_s)
        self._epoch = -1
        self._decided_tick, self._held, self._left = -(10**9), int(MetaAction.CRUISE), (NOBODY, 0)
        self._probabilities: tuple[float, ...] = ()
        """Of the policy's last answer."""
        self.counts = {"ticks": 0, "masked": 0, "fallback": 0, "braked": 0}

    def step(self, observation: Observation, directive: Directive | None, now_ns: int) -> tuple[Action, list[Event]]:
        """The action that answers `observation` (compute_ns is left to the shell), and what became of the directive.

        The policy decides once per `decision_ticks`; in between its decision holds unless mask or intent close that.
        Whatever fails, even the mask, an action comes out: then the ego slows down.
        """
        self.counts["ticks"] += 1
        try:
            return self._step(observation, directive, now_ns)
        except Exception as error:
            self.counts["fallback"] += 1
            return Action(
                epoch=observation.epoch,
                stamp_ns=now_ns,
                answers_tick=observation.tick,
                meta_action=int(MetaAction.SLOW_DOWN),
                source="fallback",
                budget_ns=round(self._config.budget_ms * 1e6),
                why=f"{type(error).__name__}: {error}"[:120],
            ), []

    def rehearse(self, node: FastNode, observation: Observation, directive: Directive | None) -> None:
        """Answer once more what `node` has answered, without consequence; decide where it would at the next tick."""
        self._decided_tick = node._decided_tick - 1
        self.step(observation, directive, 0)

    def _step(self, observation: Observation, directive: Directive | None, now_ns: int) -> tuple[Action, list[Event]]:
        lanes = lane_table(observation.lanes)
        table = self._tracks.follow(observation, rows_of(observation).tolist(), lanes)
        if observation.epoch != self._epoch:
            self._epoch = observation.epoch
            self._decided_tick, self._held, self._left = -(10**9), int(MetaAction.CRUISE), (NOBODY, 0)
        near, reasons, closed, cap = self._close(observation, table, lanes)
        intent, events = self._coordination.intent(observation, table, lanes, directive, now_ns)
        narrowed, cap = self._narrow(observation, table, lanes, near, reasons, intent, cap)
        choice = self._choose(observation, table, lanes, intent, cap, narrowed)
        if choice.source == "fallback":
            choice = choice._replace(meta=fallback(reasons, lanes, observation.target_lane))
        self.counts["fallback"] += choice.source == "fallback"
        self.counts["masked"] += choice.source == "masked"
        self.counts["braked"] += choice.meta == MetaAction.EMERGENCY_BRAKE
        why = choice.why
        if not why and choice.meta == MetaAction.EMERGENCY_BRAKE:
            why = "; ".join(sorted({c.reason for c in closed}))
        events += self._coordination.report(observation, intent, closed, choice.meta)
        return Action(
            epoch=observation.epoch,
            stamp_ns=now_ns,
            answers_tick=observation.tick,
            meta_action=int(choice.meta),
            source=choice.source,  # type: ignore[arg-type]
            speed_goal_mps=intent.speed_mps,
            directive_id=directive.id if directive else None,
            budget_ns=round(self._config.budget_ms * 1e6),
            closed=closed,
            why=why,
            probabilities=choice.probabilities,
            speed_cap_mps=cap if math.isfinite(cap) else None,
            style=intent.style,
            turn_signal=signal(observation, intent),
        ), events

    def _close(
        self, observation: Observation, table: Table, lanes: Lanes
    ) -> tuple[list[int], list[int], tuple[Closure, ...], float]:
        """The neighbours, the mask's reasons, the same as published, and its speed cap."""
        near, reasons, vehicle = [0] * (3 * len(lanes)), [0] * 6, [-1] * 6
        cap = close_actions(
            table,
            lanes,
            observation.target_speed_mps,
            observation.target_lane,
            observation.previous_lane,
            observation.sight_m,
            near,
            reasons,
            vehicle,
            self._preset,
        )
        closed = tuple(
            Closure(action=a, reason=_REASONS[reasons[a] - 1], vehicle=vehicle[a])
            for a in range(POLICY_ACTIONS)
            if reasons[a] != OPEN
        )
        return near, reasons, closed, cap

    def _narrow(
        self,
        observation: Observation,
        table: Table,
        lanes: Lanes,
        near: list[int],
        reasons: list[int],
        intent: Intent,
        cap: float,
    ) -> tuple[list[int], float]:
        """The reasons with the intent's, and the cap with that of a comfortable ride."""
        cap = min(
            cap,
            comfortable_mps(
                table,
                near,
                lanes,
                observation.target_lane,
                observation.acceleration_mps2,
                intent.speed_mps,
                intent.headway_s,
                intent.style,
            ),
        )
        self._left = hold_off(*self._left, observation.target_lane, observation.previous_lane)
        narrowed = reasons.copy()
        narrow(
            narrowed,
            table,
            near,
            lanes,
            observation.target_speed_mps,
            observation.target_lane,
            observation.previous_lane,
            self._left[0] if self._left[1] > 0 else NOBODY,
            intent.lane,
            intent.speed_mps,
            intent.headway_s,
            cap,
        )
        return narrowed, cap

    def _choose(
        self, observation: Observation, table: Table, lanes: Lanes, intent: Intent, cap: float, reasons: list[int]
    ) -> Choice:
        """What the policy chooses of what is open, or holds; its failure is the fallback's source, and why."""
        try:
            due = observation.tick - self._decided_tick >= self._config.decision_ticks
            logits: list[float] = []
            if due or not self._stateless:
                logits = self._logits(observation, table, lanes, intent, cap, reasons).tolist()
                if not math.isfinite(sum(logits)):
                    raise FloatingPointError("non-finite logits")
                self._probabilities = softmax(logits)
            meta, by = choose(logits, reasons, due, self._held)
            if due:
                self._decided_tick, self._held = observation.tick, held(meta)
        except Exception as error:  # whatever the policy does, the car gets an answer
            return Choice(MetaAction.EMERGENCY_BRAKE, "fallback", f"{type(error).__name__}: {error}"[:120])
        return Choice(meta, SOURCES[by], "", self._probabilities)

    def _logits(
        self, observation: Observation, table: Table, lanes: Lanes, intent: Intent, cap: float, reasons: list[int]
    ) -> Array:
        own, aim, x = observation.target_lane, max(intent.lane, 0), table[0][X]
        return self._policy.logits(
            features(
                table,
                math.nan if intent.lane == ANY_LANE else lanes[intent.lane][LANE_Y],
                intent.speed_mps,
                intent.headway_s,
                observation.target_speed_mps,
                observation.previous_lane >= 0,
                lanes[own][LANE_END] - x,
                cap,
                reasons[MetaAction.LEFT] == OPEN,
                reasons[MetaAction.RIGHT] == OPEN,
                own,
                aim,
                lanes[own][LANE_OPENS] - x,
                lanes[aim][LANE_END] - x,
                observation.goal_x_m - x,
                min(lanes[own][LANE_WAY], lanes[aim][LANE_WAY]) < 0,
            )
        )


def signal(observation: Observation, intent: Intent) -> int:
    """The turn signal: of the running change, or of the one that is intended."""
    here, there = observation.previous_lane, observation.target_lane
    if here < 0:
        here, there = there, there if intent.lane == ANY_LANE else intent.lane
    return (there > here) - (there < here)


def softmax(logits: list[float]) -> tuple[float, ...]:
    """The probabilities that logits stand for."""
    most = max(logits)
    weights = [math.exp(logit - most) for logit in logits]
    total = sum(weights)
    return tuple(weight / total for weight in weights)


def fallback(reasons: list[int], lanes: Lanes, target_lane: int) -> int:
    """The rule that drives when the policy cannot: home from a borrowed lane, slower if need be, else hold."""
    if lanes[target_lane][LANE_WAY] < 0 and reasons[MetaAction.RIGHT] == OPEN:
        return MetaAction.RIGHT
    for action in MILDEST:
        if reasons[action] == OPEN:
            return action
    return MetaAction.EMERGENCY_BRAKE
