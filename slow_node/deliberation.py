"""The slow system's state machine: which command counts, what has become of it, and when to think again.

Pure: no clock, no sockets, no asyncio. The shell passes the time in and carries the effects out. The newest command
wins; one thought is in flight; one intent is active and outlives its directives until it is fulfilled, cancelled,
replaced or expired. An overtaking intent is watched: its directive is renewed before it expires, it is thought about
again when the fast node delays it, and it ends on the ego's own side of the road.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from schemas.clock import NS
from schemas.measures import INF
from schemas.messages import Command, Directive, Event, Reply, ReplyOutcome
from schemas.wish import BEHIND_M
from slow_node.directive import Plan, Refusal, plan_of, return_plan
from slow_node.replies import sentence
from slow_node.scene import Scene
from slow_node.slots import Slots
from slow_node.thinking import Verdict

SCENE_MAX_AGE_S = 10.0
RENEW_BEFORE_S = 3.0
RETHINK_EVERY_S = 3.0
INTENT_MAX_S = 120.0
"""An overtaking wish that has not come true by then is given up, rather than renewed for ever."""
TEXT_CHARS = 200


@dataclass(frozen=True)
class Call:
    """Effect: think about this. At most one is in flight; a newer one replaces it."""

    id: int
    command: str
    scene: Scene
    intent: str = ""


@dataclass(frozen=True)
class Learn:
    """Effect: keep a decision and what came of it in the memory bank."""

    command: str
    scene: Scene
    slots: Slots
    outcome: str
    """"fulfilled", "expired"; with the rule that held it up, where one did."""
    took_s: float
    """From the directive to its end."""
    min_ttc_s: float
    """Smallest time to collision meanwhile (`Scene.ttc_s`); inf: the ego never closed in on anybody."""


@dataclass(frozen=True)
class Drop:
    """Effect: the thought in flight is of no use any more."""


Effect = Call | Drop | Learn | Directive | Reply


@dataclass(frozen=True)
class _Pending:
    call_id: int
    command: Command
    scene: Scene
    rethink: bool


@dataclass(frozen=True)
class _Intent:
    command: Command
    slots: Slots
    scene: Scene
    plan: Plan
    directive: Directive
    began_ns: int
    directive_ids: frozenset[int]
    lead_id: int | None
    returning: bool = False
    rethought_ns: int = 0
    vetoed_by: str = ""
    """The mask's rule that last delayed it."""
    min_ttc_s: float = INF


class Deliberation:
    """Commands, scenes, events and verdicts in; effects out."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._pending: _Pending | None = None
        self._intent: _Intent | None = None
        self._last_id = 0
        self._calls = 0
        self.figures: dict[str, float] = {"commands": 0, "directives": 0, "refused": 0}

    @property
    def epoch(self) -> int:
        return self._scene.epoch if self._scene else 0

    def refuse_payload(self, why: str, command_id: int, now_ns: int) -> list[Effect]:
        """A payload that is no command."""
        self.figures["commands"] += 1
        self.figures["refused"] += 1
        return [Reply(epoch=self.epoch, stamp_ns=now_ns, command_id=command_id, outcome="refused", text="", why=why,
                      say=f"I cannot take that: {why}.")]

    def on_command(self, command: Command, now_ns: int) -> list[Effect]:
        """Heard at once; whatever was being thought about is superseded."""
        self.figures["commands"] += 1
        effects: list[Effect] = [self._reply(command, "heard", now_ns)]
        if self._pending is not None:
            if not self._pending.rethink:
                effects.append(self._reply(self._pending.command, "superseded", now_ns, why="a newer command came"))
            effects.append(Drop())
            self._pending = None
        scene = self._scene
        if scene is None or now_ns - scene.stamp_ns > SCENE_MAX_AGE_S * NS:
            why = "the car's surroundings are unknown: no recent observation"
            return [*effects, self._refused(command, Refusal(why, "I cannot see the road at the moment."), now_ns)]
        return [*effects, self._call(command, scene, rethink=False)]

    def on_verdict(self, call_id: int, verdict: Verdict, now_ns: int) -> list[Effect]:
        """A thought has ended. Thoughts that were replaced meanwhile count for nothing."""
        pending = self._pending
        if pending is None or pending.call_id != call_id:
            return []
        self._pending = None
        if pending.rethink:
            return self._rethought(verdict, now_ns)
        command = pending.command
        if verdict.slots is None:
            if not verdict.model_answered:
                say = "I cannot think about that right now; I keep driving as before."
                return [self._reply(command, "failed", now_ns, why=verdict.why, say=say)]
            return [self._refused(command, Refusal(verdict.why, sentence("unclear", "en")), now_ns)]
        scene = pending.scene
        if self._scene is not None and self._scene.epoch != scene.epoch:
            scene = self._scene  # the world was reset meanwhile: the wish stands, its scene does not
        if now_ns - scene.stamp_ns > SCENE_MAX_AGE_S * NS:
            say = sentence("again", verdict.slots.language)
            return [self._refused(command, Refusal("the answer came too late for its scene", say), now_ns)]
        plan = plan_of(verdict.slots, scene)
        if isinstance(plan, Refusal):
            return [self._refused(command, replace(plan, why=verdict.why or plan.why), now_ns)]
        return self._begin(command, verdict, scene, plan, now_ns)

    def on_event(self, event: Event, now_ns: int) -> list[Effect]:
        """What the fast node reports about the intent's directives."""
        intent = self._intent
        if intent is None or event.epoch != self.epoch or event.directive_id not in intent.directive_ids:
            return []
        current = event.directive_id == intent.directive.id
        if event.kind == "fulfilled":
            if self._scene is not None and self._scene.borrowing and intent.plan.manoeuvre == "overtake":
                return []  # the first half is done; the manoeuvre ends on our own side of the road
            self._intent = None
            say = sentence("done", intent.slots.language)
            return [self._reply(intent.command, "fulfilled", now_ns, directive_id=event.directive_id, say=say),
                    self._learn(intent, "fulfilled", now_ns)]
        if event.kind == "expired" and current:
            return self._end(intent, "expired", event.detail or "the directive expired", now_ns)
        if event.kind in ("vetoed", "delayed") and current and event.rule:
            self._intent = intent = replace(intent, vetoed_by=event.rule)
        if event.kind in ("vetoed", "delayed") and current and intent.plan.manoeuvre == "overtake":
            return self._rethink(intent, f"{event.kind} by the fast system ({event.rule or 'safety'})", now_ns)
        return []

    def on_scene(self, scene: Scene, now_ns: int) -> list[Effect]:
        """A new observation: watch over the active intent."""
        reset = self._scene is not None and self._scene.epoch != scene.epoch
        self._scene = scene
        intent = self._intent
        if intent is None:
            return []
        if reset:
            return self._renew_in_new_world(intent, scene, now_ns)
        if scene.ttc_s < intent.min_ttc_s:
            self._intent = intent = replace(intent, min_ttc_s=scene.ttc_s)
        if intent.plan.manoeuvre != "overtake":
            expires_ns = intent.directive.stamp_ns + round((intent.directive.ttl_s + 1.0) * NS)
            if now_ns > expires_ns:  # a second after the fast node should have said so
                return self._end(intent, "expired", "the directive expired", now_ns)
            return []
        if now_ns - intent.began_ns > INTENT_MAX_S * NS and not scene.borrowing:
            return self._end(intent, "expired", f"no chance within {INTENT_MAX_S:.0f} s", now_ns)
        if not intent.returning and scene.borrowing and _passed(intent, scene):
            # By rule, not by the model: the seconds of a call would be spent facing oncoming traffic.
            self._intent = intent = replace(intent, returning=True)
            return self._issue(intent, return_plan(scene, intent.slots.language), scene, now_ns)
        if now_ns - intent.directive.stamp_ns > (intent.directive.ttl_s - RENEW_BEFORE_S) * NS:
            return self._issue(intent, replace(intent.plan, say=""), scene, now_ns)
        return []

    def _begin(self, command: Command, verdict: Verdict, scene: Scene, plan: Plan, now_ns: int) -> list[Effect]:
        assert verdict.slots is not None
        effects: list[Effect] = []
        if self._intent is not None:
            outcome: ReplyOutcome = "cancelled" if verdict.slots.cancel else "superseded"
            effects.append(self._reply(self._intent.command, outcome, now_ns, why="by a newer command"))
        directive = self._directive(command, verdict.slots, plan, scene, now_ns)
        lead_id = scene.lead.id if scene.lead else None
        ids = frozenset({directive.id})
        self._intent = _Intent(command, verdict.slots, scene, plan, directive, now_ns, ids, lead_id)
        if verdict.slots.cancel:
            self._intent = None  # giving up is done with its directive: nothing to wait for
        return [*effects, directive,
                self._reply(command, "issued", now_ns, directive_id=directive.id, say=plan.say, why=verdict.why)]

    def _issue(self, intent: _Intent, plan: Plan, scene: Scene, now_ns: int) -> list[Effect]:
        """Another directive for the same intent; the passenger hears of it only where there is something to say."""
        directive = self._directive(intent.command, intent.slots, plan, scene, now_ns)
        ids = intent.directive_ids | {directive.id}
        self._intent = replace(intent, plan=plan, directive=directive, directive_ids=ids)
        if not plan.say:
            return [directive]
        return [directive, self._reply(intent.command, "issued", now_ns, directive_id=directive.id, say=plan.say)]

    def _renew_in_new_world(self, intent: _Intent, scene: Scene, now_ns: int) -> list[Effect]:
        plan = plan_of(intent.slots, scene)
        if isinstance(plan, Refusal):
            return self._end(intent, "expired", f"the world was reset: {plan.why}", now_ns)
        lead_id = scene.lead.id if scene.lead else None
        fresh = replace(intent, began_ns=now_ns, scene=scene, lead_id=lead_id, returning=False,
                        min_ttc_s=INF)
        return self._issue(fresh, replace(plan, say=""), scene, now_ns)

    def _rethink(self, intent: _Intent, what: str, now_ns: int) -> list[Effect]:
        scene = self._scene
        if self._pending is not None or scene is None or intent.returning or scene.borrowing:
            return []
        if now_ns - intent.rethought_ns < RETHINK_EVERY_S * NS:
            return []
        self._intent = replace(intent, rethought_ns=now_ns)
        return [self._call(intent.command, scene, rethink=True, intent=f"{intent.plan.manoeuvre}, {what}")]

    def _rethought(self, verdict: Verdict, now_ns: int) -> list[Effect]:
        """A second thought may refresh the manoeuvre for the newest scene; only the passenger can give it up."""
        intent, scene = self._intent, self._scene
        if intent is None or scene is None or verdict.slots is None or intent.returning or scene.borrowing:
            return []
        plan = plan_of(verdict.slots, scene)
        if isinstance(plan, Refusal) or plan.manoeuvre != "overtake":
            return []
        self._intent = intent = replace(intent, lead_id=scene.lead.id if scene.lead else intent.lead_id)
        return self._issue(intent, replace(plan, say=""), scene, now_ns)

    def _end(self, intent: _Intent, outcome: ReplyOutcome, why: str, now_ns: int) -> list[Effect]:
        self._intent = None
        return [self._reply(intent.command, outcome, now_ns, why=why, directive_id=intent.directive.id),
                self._learn(intent, outcome, now_ns)]

    @staticmethod
    def _learn(intent: _Intent, outcome: str, now_ns: int) -> Learn:
        came = f"{outcome}, held up by {intent.vetoed_by}" if intent.vetoed_by else outcome
        took_s = (now_ns - intent.began_ns) / NS
        return Learn(intent.command.text, intent.scene, intent.slots, came, took_s, intent.min_ttc_s)

    def _call(self, command: Command, scene: Scene, *, rethink: bool, intent: str = "") -> Call:
        self._calls += 1
        self._pending = _Pending(self._calls, command, scene, rethink)
        return Call(self._calls, command.text, scene, intent)

    def _directive(self, command: Command, slots: Slots, plan: Plan, scene: Scene, now_ns: int) -> Directive:
        self._last_id = max(self._last_id + 1, now_ns // 1000)
        self.figures["directives"] += 1
        return Directive(
            epoch=scene.epoch, stamp_ns=now_ns, id=self._last_id, command_id=command.id, scene_tick=scene.tick,
            manoeuvre=plan.manoeuvre, target_lane=plan.target_lane, target_speed_mps=plan.target_speed_mps,
            headway_s=plan.headway_s, style=plan.style, reasoning=slots.reasoning, say=plan.say)

    def _refused(self, command: Command, refusal: Refusal, now_ns: int) -> Reply:
        self.figures["refused"] += 1
        return self._reply(command, "refused", now_ns, why=refusal.why, say=refusal.say)

    def _reply(self, command: Command, outcome: ReplyOutcome, now_ns: int, *, say: str = "", why: str = "",
               directive_id: int | None = None) -> Reply:
        return Reply(epoch=self.epoch, stamp_ns=now_ns, command_id=command.id, outcome=outcome,
                     text=command.text[:TEXT_CHARS], say=say, why=why[:TEXT_CHARS], directive_id=directive_id)


def _passed(intent: _Intent, scene: Scene) -> bool:
    """The car that the intent was about lies behind the ego, or is out of sight."""
    if intent.lead_id is None or intent.lead_id not in scene.positions:
        return True
    return scene.x_m - scene.positions[intent.lead_id] > scene.length_m + BEHIND_M
