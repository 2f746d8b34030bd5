"""A passenger in a lock-step drive, with the slow node's own deliberation: what is said is understood as it drives,
and comes as late as it is told to, in the drive's time and not in ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from deploy.lab.lockstep import drive
from fast_node.policies.policy import NamedPolicy
from schemas.driving.intent import ANY_LANE
from schemas.driving.road import HZ, NOBODY, has_passed
from schemas.runtime.clock import NS
from schemas.wire.codec import rows_of
from schemas.wire.messages import Command, Directive, Event, Observation, Reply
from schemas.wire.program import Step
from sim_node.config import SimConfig
from sim_node.metrics import Recorder
from sim_node.node import SimNode
from slow_node.deliberation import Deliberation
from slow_node.effects import Abandon, Effect, Interpret
from slow_node.interpretation import Interpretation
from slow_node.planning.directive import directive_of
from slow_node.planning.scene import Scene, encode_scene
from slow_node.planning.steps import slots_of

BUDGET_S = 60.0
SPEED_MET_MPS, HEADWAY_MET = 1.0, 0.9
USUAL_HEADWAY_S = 1.5

Heard = tuple[float, Interpretation]
"""What an interpretation comes to, and after how many seconds."""


@dataclass(frozen=True)
class Wish:
    """A command, and what somebody who understands it would do."""

    scenario: str
    text: str
    steps: tuple[Step, ...] = ()
    """Empty: nothing is to be done about it."""
    after_s: float = 0.0
    """How long after it was said it is to begin."""


@dataclass(frozen=True)
class Ridden:
    """What became of a wish."""

    success: bool
    """What was asked for came about, without a collision; for nothing: nothing was done."""
    compliance: float
    """The share of the time from then on in which the car did it."""
    ride_score: float
    collided: bool
    directives: int


class Rider:
    """Says one thing, and has it interpreted. `interpret` tells what comes of it, and how much later."""

    def __init__(
        self, wish: Wish | None, at_s: float, interpret: Callable[[Interpret], Sequence[Heard]], *, asks_again: bool
    ) -> None:
        self._wish, self._at_tick, self._interpret = wish, round(at_s * HZ), interpret
        self._deliberation = Deliberation(BUDGET_S, asks_again=asks_again)
        self._due: list[tuple[int, int, Interpretation]] = []
        self._events: list[Event] = []
        self.directives = 0
        self.replies: list[Reply] = []

    def hear(self, events: Sequence[Event]) -> None:
        """What the fast node has told of; taken in at the next tick."""
        self._events += events

    def ask(self, observation: Observation, now_ns: int) -> Directive | None:
        """The newest directive of this tick, if there is one."""
        deliberation = self._deliberation
        found = self._carried_out(deliberation.on_scene(encode_scene(observation), now_ns), now_ns)
        events, self._events = self._events, []
        for event in events:
            found += self._carried_out(deliberation.on_event(event, now_ns), now_ns)
        due = [one for one in self._due if one[0] <= now_ns]
        self._due = [one for one in self._due if one[0] > now_ns]
        for _, identity, interpretation in due:
            found += self._carried_out(deliberation.on_interpretation(identity, interpretation, now_ns), now_ns)
        if self._wish is not None and observation.tick == self._at_tick:
            command = Command(epoch=observation.epoch, stamp_ns=now_ns, id=1, text=self._wish.text)
            found += self._carried_out(deliberation.on_command(command, now_ns), now_ns)
        self.directives += len(found)
        return found[-1] if found else None

    def _carried_out(self, effects: list[Effect], now_ns: int) -> list[Directive]:
        for effect in effects:
            if isinstance(effect, Abandon):
                self._due = []
            elif isinstance(effect, Interpret):
                self._due = [(now_ns + round(s * NS), effect.id, found) for s, found in self._interpret(effect)]
            elif isinstance(effect, Reply):
                self.replies.append(effect)
        return [effect for effect in effects if isinstance(effect, Directive)]


def scene_at(scenario: str, seed: int, policy: NamedPolicy, at_s: float) -> Scene:
    """What is seen on this road so many seconds after its start, if nothing was said."""
    *_, last = drive(SimNode(SimConfig(scenario=scenario, seed=seed)), policy, lambda *_: None, at_s + 1 / HZ)
    return encode_scene(last.observation)


def question(wish: Wish, scene: Scene) -> Interpret:
    """What the deliberation has interpreted once the wish is said on this scene."""
    deliberation = Deliberation(BUDGET_S)
    deliberation.on_scene(scene, scene.stamp_ns)
    command = Command(epoch=scene.epoch, stamp_ns=scene.stamp_ns, id=1, text=wish.text)
    return next(one for one in deliberation.on_command(command, scene.stamp_ns) if isinstance(one, Interpret))


def ride(wish: Wish, rider: Rider, policy: NamedPolicy, *, seed: int, at_s: float, duration_s: float) -> Ridden:
    """Drive one episode with somebody in it. Deterministic."""
    sim = SimNode(SimConfig(scenario=wish.scenario, seed=seed))
    judge = _Judge(wish, round((at_s + wish.after_s) * HZ), SimConfig(scenario=wish.scenario, seed=seed))
    for tick in drive(sim, policy, rider.ask, duration_s):
        rider.hear(tick.events)
        judge.look(tick.observation)
    return judge.verdict(rider)


class _Judge:
    """Holds a drive against what was wished, whoever has understood it and how."""

    def __init__(self, wish: Wish, from_tick: int, config: SimConfig) -> None:
        self._wish, self._from_tick = wish, from_tick
        self._recorder = Recorder(config.road(), 1)
        self._gold: Directive | None = None
        self._begun: Scene | None = None
        self._ticks = self._kept = 0
        self._speed = 0.0
        self._passed = self._collided = self._met = False

    def look(self, seen: Observation) -> None:
        scene = encode_scene(seen)
        if seen.tick <= self._from_tick:
            self._speed = float(round(seen.target_speed_mps))
        if seen.tick == self._from_tick and self._wish.steps:
            gold = directive_of(slots_of(self._wish.steps, scene, "en"), scene)
            if isinstance(gold, Directive):
                self._gold, self._begun = gold, scene
        self._collided |= seen.crashed
        if self._gold is not None and self._begun is not None:
            met = self._is_met(scene, self._gold, self._begun)
            self._ticks, self._kept, self._met = self._ticks + 1, self._kept + met, self._met or met
        self._record(seen)

    def _is_met(self, scene: Scene, gold: Directive, begun: Scene) -> bool:
        if gold.manoeuvre == "overtake":
            lead = begun.lead
            car = None if lead is None else scene.others.get(lead.id)
            self._passed |= car is None or has_passed(scene.ego, car)
            return self._passed and not scene.borrowing
        if gold.target_lane is not None and scene.ego_lane != gold.target_lane:
            return False
        if gold.target_speed_mps is not None and abs(scene.speed_mps - gold.target_speed_mps) > SPEED_MET_MPS:
            return False
        if gold.headway_s is not None and scene.lead is not None and scene.speed_mps > 1.0:
            return scene.lead.gap_m / scene.speed_mps >= HEADWAY_MET * gold.headway_s
        return True

    def _record(self, seen: Observation) -> None:
        rows, gold = rows_of(seen)[None], self._gold
        asked = gold is not None
        overtakes = gold is not None and gold.manoeuvre == "overtake" and self._begun is not None
        lead = self._begun.lead if overtakes and self._begun is not None else None
        lane = gold.target_lane if gold is not None and gold.target_lane is not None and not overtakes else ANY_LANE
        speed = gold.target_speed_mps if gold is not None and gold.target_speed_mps is not None else self._speed
        headway = gold.headway_s if gold is not None and gold.headway_s is not None else USUAL_HEADWAY_S
        self._recorder.tick(
            rows,
            np.array([seen.acceleration_mps2]),
            np.array([seen.target_lane]),
            np.array([seen.previous_lane]),
            np.array([seen.crashed]),
            np.ones(1, np.bool_),
            np.array([lane]),
            np.array([speed]),
            wish_headway=np.array([headway]),
            pass_id=np.array([lead.id if lead is not None else NOBODY]),
            asked=np.array([asked]),
        )

    def verdict(self, rider: Rider) -> Ridden:
        if self._wish.steps:
            success, compliance = self._met, self._kept / max(self._ticks, 1)
        else:
            success, compliance = rider.directives == 0, float(rider.directives == 0)
        score = self._recorder.results()[0].ride_score
        return Ridden(success and not self._collided, compliance, score, self._collided, rider.directives)
