"""The slow system's state machine: which command counts, what has become of it, and when to think again.

Pure: no clock, no sockets, no asyncio. The shell passes the time in and carries the effects out. The newest command
wins; one thought is in flight; one intent is active and outlives its directives until it is fulfilled, cancelled,
replaced or given up. Whatever was wished, its directive is renewed before it expires. The intent is thought about
again when its road changes: the car ahead is passed, the fast node holds the directive up, the lane is clear again, a
slow car is ahead of somebody in a hurry. The words have not changed then, so no model is asked: the same slots are
planned anew for the present scene, by `slow_node.planning.directive`'s rules, at most once in `RETHINK_EVERY_S`.

A hurry and a wished gap stand on after they were fulfilled, without further replies: the next slow car is overtaken
too, and where the hurry took the ego to the left on a one-way road it is asked back to the right once that is free.
Other wishes end with their fulfilment: the fast node keeps the speed and the lane that it has reached.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from schemas.driving.intent import BEHIND_M
from schemas.driving.measures import INF
from schemas.runtime.clock import NS
from schemas.wire import topics
from schemas.wire.messages import Command, Directive, Event, Reply, ReplyOutcome
from slow_node.planning.directive import (
    Plan,
    Refusal,
    hurried,
    may_take,
    on_this_road,
    onward_plan,
    plan_of,
    return_plan,
    right_plan,
    slow_lead,
)
from slow_node.planning.replies import sentence
from slow_node.planning.scene import Scene
from slow_node.thinking import Verdict
from slow_node.understanding.slots import Slots

SCENE_MAX_AGE_S = 10.0
RENEW_BEFORE_S = 3.0
RETHINK_EVERY_S = 3.0
INTENT_MAX_S = 120.0
"""A wish that has not come true by then is given up, rather than renewed for ever."""
TEXT_CHARS = 200


@dataclass(frozen=True)
class Call:
    """Effect: think about this. At most one is in flight; a newer one replaces it."""

    id: int
    command: str
    scene: Scene
    intent: str = ""
    """The manoeuvre wished before that the fast system is holding up; "" where there is none."""
    veto: str = ""
    """The rule by which it does."""


@dataclass(frozen=True)
class Learn:
    """Effect: keep a decision and what came of it in the memory bank."""

    command: str
    scene: Scene
    slots: Slots
    outcome: str
    """"fulfilled", "expired", "superseded" or "cancelled"; with the rule that held it up, where one did."""
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
    """The car that an overtake is about."""
    from_lane: int
    """The rightmost own lane that it was planned from: a hurry goes back as far as that."""
    fulfilled: bool = False
    """The passenger has had the last reply; the wish stands on."""
    returning: bool = False
    news: str = ""
    """Why to think again, as soon as the rate allows."""
    rethought_ns: int | None = None
    vetoed_by: str = ""
    """The mask's rule that last delayed it."""
    min_ttc_s: float = INF


class Deliberation:
    """Commands, scenes, events and verdicts in; effects out."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._pending: _Pending | None = None
        self._intent: _Intent | None = None
        self._language = "en"
        self._last_id = 0
        self._calls = 0
        self.figures: dict[str, float] = {"commands": 0, "directives": 0, "refused": 0, "rethoughts": 0}

    @property
    def epoch(self) -> int:
        return self._scene.epoch if self._scene else 0

    def refuse_payload(self, why: str, command_id: int, now_ns: int) -> list[Effect]:
        """A payload that is no command."""
        self.figures["commands"] += 1
        self.figures["refused"] += 1
        return [
            Reply(
                epoch=self.epoch,
                stamp_ns=now_ns,
                command_id=command_id,
                outcome="refused",
                text="",
                why=why,
                say=sentence("unusable", self._language),
            )
        ]

    def on_command(self, command: Command, now_ns: int) -> list[Effect]:
        """Heard at once; whatever was being thought about is superseded. A command out of the past is not obeyed."""
        self.figures["commands"] += 1
        age_s = (now_ns - command.stamp_ns) / NS
        if age_s > topics.COMMAND.stale_after_s:
            return [self._refused(command, f"the command came {age_s:.0f} s late", "again", now_ns)]
        effects: list[Effect] = [self._reply(command, "heard", now_ns)]
        if self._pending is not None:
            say = sentence("superseded", self._language)
            effects += [
                self._reply(self._pending.command, "superseded", now_ns, say=say, why="a newer command came"),
                Drop(),
            ]
            self._pending = None
        scene = self._scene
        if scene is None or now_ns - scene.stamp_ns > SCENE_MAX_AGE_S * NS:
            why = "the car's surroundings are unknown: no recent observation"
            return [*effects, self._refused(command, why, "blind", now_ns)]
        self._calls += 1
        self._pending = _Pending(self._calls, command, scene)
        active = self._intent
        if active is not None and active.vetoed_by and not active.fulfilled:
            return [*effects, Call(self._calls, command.text, scene, active.plan.manoeuvre, active.vetoed_by)]
        return [*effects, Call(self._calls, command.text, scene)]

    def on_verdict(self, call_id: int, verdict: Verdict, now_ns: int) -> list[Effect]:
        """A thought has ended: the gates, in order, are its schema, the road, and how old its scene is.

        Thoughts that were replaced meanwhile count for nothing.
        """
        pending = self._pending
        if pending is None or pending.call_id != call_id:
            return []
        self._pending = None
        command = pending.command
        if verdict.slots is None:
            if not verdict.model_answered:
                say = sentence("failed", self._language)
                return [self._reply(command, "failed", now_ns, why=verdict.why, say=say)]
            return [self._refused(command, verdict.why, "unclear", now_ns)]
        self._language = verdict.slots.language
        scene = pending.scene
        if self._scene is not None and self._scene.epoch != scene.epoch:
            scene = self._scene  # the world was reset meanwhile: the wish stands, its scene does not
        plan = plan_of(verdict.slots, scene)
        if isinstance(plan, Refusal):
            return [self._refused(command, verdict.why or plan.why, "", now_ns, say=plan.say)]
        if now_ns - scene.stamp_ns > SCENE_MAX_AGE_S * NS:
            return [self._refused(command, "the answer came too late for its scene", "again", now_ns)]
        return self._begin(command, verdict.slots, verdict.why, scene, plan, now_ns)

    def on_event(self, event: Event, now_ns: int) -> list[Effect]:
        """What the fast node reports about the intent's directives. An expired one is renewed by the next scene."""
        intent = self._intent
        if intent is None or event.epoch != self.epoch or event.directive_id not in intent.directive_ids:
            return []
        if event.kind == "fulfilled":
            return self._fulfilled(intent, event.directive_id, now_ns)
        if event.kind in ("vetoed", "delayed") and event.directive_id == intent.directive.id:
            self._intent = replace(
                intent,
                vetoed_by=event.rule or intent.vetoed_by,
                news=f"{event.kind} by the fast system ({event.rule or 'safety'})",
            )
            return self._think_again(now_ns)
        return []

    def on_scene(self, scene: Scene, now_ns: int) -> list[Effect]:
        """A new observation: watch over the active intent."""
        before, self._scene = self._scene, scene
        intent = self._intent
        if intent is None:
            return []
        if before is None or before.epoch != scene.epoch:
            return self._renew_in_new_world(intent, scene, now_ns)
        intent = replace(intent, min_ttc_s=min(intent.min_ttc_s, scene.ttc_s))
        intent = self._intent = replace(intent, news=self._news(intent, before, scene) or intent.news)
        if not intent.fulfilled and not scene.borrowing and now_ns - intent.began_ns > INTENT_MAX_S * NS:
            return self._expire(intent, f"no chance within {INTENT_MAX_S:.0f} s", now_ns)
        passing = intent.plan.manoeuvre == "overtake"
        if passing and not intent.returning and scene.borrowing and _passed(intent, scene):
            # At once: seconds spent waiting would be spent facing oncoming traffic.
            plan = return_plan(scene, intent.slots.language)
            return self._issue(replace(intent, returning=True), plan, scene, "the car ahead is passed", now_ns)
        if now_ns - intent.directive.stamp_ns > (intent.directive.ttl_s - RENEW_BEFORE_S) * NS:
            return self._issue(intent, self._plan_now(intent, scene), scene, "about to expire", now_ns)
        return self._think_again(now_ns)

    def _begin(self, command: Command, slots: Slots, why: str, scene: Scene, plan: Plan, now_ns: int) -> list[Effect]:
        effects: list[Effect] = []
        old = self._intent
        if old is not None and not old.fulfilled:
            outcome: ReplyOutcome = "cancelled" if slots.cancel else "superseded"
            say = sentence(outcome, old.slots.language)
            effects.append(self._reply(old.command, outcome, now_ns, say=say, why="by a newer command"))
            if old.vetoed_by:
                effects.append(self._learn(old, outcome, now_ns))
        directive = self._directive(command, plan, scene, slots.reasoning, now_ns)
        lead_id = scene.lead.id if scene.lead else None
        self._intent = _Intent(
            command, slots, scene, plan, directive, now_ns, frozenset({directive.id}), lead_id, scene.home_lane
        )
        issued = self._reply(command, "issued", now_ns, directive_id=directive.id, say=plan.say, why=why)
        effects += [directive, issued]
        if slots.cancel:
            self._intent = None  # giving up is done with its directive: nothing to wait for
            effects.append(self._done(command, slots, directive.id, now_ns))
        return effects

    def _fulfilled(self, intent: _Intent, directive_id: int, now_ns: int) -> list[Effect]:
        """The passenger hears of it once; what stands on is held by a `cruise`, which the fast node goes on with."""
        scene, plan = self._scene, intent.plan
        if scene is None or (scene.borrowing and plan.manoeuvre == "overtake"):
            return []  # the first half is done; the manoeuvre ends on our own side of the road
        if intent.fulfilled and directive_id != intent.directive.id:
            return []
        effects: list[Effect] = []
        if not intent.fulfilled:
            effects = [
                self._done(intent.command, intent.slots, directive_id, now_ns),
                self._learn(intent, "fulfilled", now_ns),
            ]
        if not hurried(intent.slots) and plan.headway_s is None:
            self._intent = None
            return effects
        intent = replace(intent, fulfilled=True, returning=False, news="")
        if plan.manoeuvre == "follow":
            return [*effects, *self._issue(intent, replace(plan, manoeuvre="cruise", say=""), scene, "held", now_ns)]
        if plan.manoeuvre == "overtake":
            intent = replace(intent, plan=Plan("cruise", None, plan.target_speed_mps))
        self._intent = intent
        return effects

    def _news(self, intent: _Intent, before: Scene, scene: Scene) -> str:
        """What has changed on the intent's road, or calls for more from a hurry; "" for nothing."""
        lane, passing = intent.plan.target_lane, intent.plan.manoeuvre == "overtake"
        if passing and _passed(intent, scene) and not _passed(intent, before):
            return "the car ahead is passed"
        if lane is not None and lane != scene.ego_lane and lane in scene.free_lanes and lane not in before.free_lanes:
            return f"lane {lane} is clear again"
        if passing or not hurried(intent.slots):
            return ""
        if slow_lead(scene) and (intent.fulfilled or scene.two_way):
            return "a slow car is ahead"
        if self._right_again(intent, scene) and lane != scene.home_lane + 1:
            return "the right lane is free"
        if self._too_slow_there(intent, scene):
            return "a slow car is on the right"
        return ""

    def _right_again(self, intent: _Intent, scene: Scene) -> bool:
        """A hurry that is over its first car, one-way and farther left than it began, could keep right."""
        right = scene.home_lane + 1
        return (
            intent.fulfilled
            and not scene.two_way
            and hurried(intent.slots)
            and right <= intent.from_lane
            and may_take(scene, right)
            and right in scene.free_lanes
            and right not in scene.slow_lanes
        )

    def _too_slow_there(self, intent: _Intent, scene: Scene) -> bool:
        """It was asked back to the right, has not gone yet, and would run up to a slow car there."""
        lane = intent.plan.target_lane
        return intent.fulfilled and hurried(intent.slots) and lane == scene.home_lane + 1 and lane in scene.slow_lanes

    def _think_again(self, now_ns: int) -> list[Effect]:
        """Plan anew for what is new, at a bounded rate; in the middle of a manoeuvre on the wrong side never.

        An unchanged plan is not said again: the fast node would forget how long it has been waiting. An overtake it
        knows for the same manoeuvre, and carries on.
        """
        intent, scene = self._intent, self._scene
        if intent is None or scene is None or not intent.news:
            return []
        if intent.rethought_ns is not None and now_ns - intent.rethought_ns < RETHINK_EVERY_S * NS:
            return []
        what = intent.news
        intent = self._intent = replace(intent, news="")
        if scene.borrowing or intent.returning:
            return []
        self.figures["rethoughts"] += 1
        intent = self._intent = replace(intent, rethought_ns=now_ns)
        plan = self._plan_now(intent, scene)
        if plan.manoeuvre != "overtake" and plan == replace(intent.plan, say=plan.say):
            return []
        return self._issue(intent, plan, scene, what, now_ns)

    def _plan_now(self, intent: _Intent, scene: Scene) -> Plan:
        """The same words on the road as it is now.

        What is relative to the moment it was said (left, slower, this gap), or half done, keeps the plan it has.
        """
        kept = on_this_road(intent.plan, scene)
        passing = intent.plan.manoeuvre == "overtake"
        if scene.borrowing or intent.returning or (passing and scene.home_lane == intent.plan.target_lane):
            return kept
        if passing or hurried(intent.slots):
            fresh = onward_plan(intent.slots, scene) if intent.fulfilled else plan_of(intent.slots, scene)
            if isinstance(fresh, Plan) and fresh.manoeuvre == "overtake":
                return replace(fresh, say="") if passing else fresh
        if not passing and self._right_again(intent, scene):
            return right_plan(scene, intent.slots.language)
        if not passing and self._too_slow_there(intent, scene):
            return replace(kept, target_lane=None)
        return kept

    def _issue(self, intent: _Intent, plan: Plan, scene: Scene, what: str, now_ns: int) -> list[Effect]:
        """Another directive for the same intent; a reply only where there is something to say, and none after the last.

        `what`: the reason for it, kept with the directive.
        """
        directive = self._directive(intent.command, plan, scene, f"again: {what}", now_ns)
        lead_id = intent.lead_id
        if plan.manoeuvre == "overtake" and not scene.borrowing and scene.lead is not None:
            lead_id = scene.lead.id
        ids = frozenset({directive.id}) if intent.fulfilled else intent.directive_ids | {directive.id}
        self._intent = replace(
            intent,
            plan=plan,
            directive=directive,
            directive_ids=ids,
            lead_id=lead_id,
            from_lane=max(intent.from_lane, scene.home_lane),
        )
        if not plan.say or intent.fulfilled:
            return [directive]
        return [directive, self._reply(intent.command, "issued", now_ns, directive_id=directive.id, say=plan.say)]

    def _renew_in_new_world(self, intent: _Intent, scene: Scene, now_ns: int) -> list[Effect]:
        plan = plan_of(intent.slots, scene)
        if isinstance(plan, Refusal):
            return self._expire(intent, f"the world was reset: {plan.why}", now_ns)
        fresh = replace(
            intent,
            began_ns=now_ns,
            scene=scene,
            lead_id=scene.lead.id if scene.lead else None,
            from_lane=scene.home_lane,
            returning=False,
            news="",
            min_ttc_s=INF,
        )
        return self._issue(fresh, replace(plan, say=""), scene, "the world was reset", now_ns)

    def _expire(self, intent: _Intent, why: str, now_ns: int) -> list[Effect]:
        self._intent = None
        if intent.fulfilled:
            return []
        say = sentence("expired", intent.slots.language)
        return [
            self._reply(intent.command, "expired", now_ns, say=say, why=why, directive_id=intent.directive.id),
            self._learn(intent, "expired", now_ns),
        ]

    def _done(self, command: Command, slots: Slots, directive_id: int, now_ns: int) -> Reply:
        return self._reply(
            command, "fulfilled", now_ns, directive_id=directive_id, say=sentence("done", slots.language)
        )

    @staticmethod
    def _learn(intent: _Intent, outcome: str, now_ns: int) -> Learn:
        came = f"{outcome}, held up by {intent.vetoed_by}" if intent.vetoed_by else outcome
        took_s = (now_ns - intent.began_ns) / NS
        return Learn(intent.command.text, intent.scene, intent.slots, came, took_s, intent.min_ttc_s)

    def _directive(self, command: Command, plan: Plan, scene: Scene, reasoning: str, now_ns: int) -> Directive:
        self._last_id = max(self._last_id + 1, now_ns // 1000)
        self.figures["directives"] += 1
        return Directive(
            epoch=scene.epoch,
            stamp_ns=now_ns,
            id=self._last_id,
            command_id=command.id,
            scene_tick=scene.tick,
            manoeuvre=plan.manoeuvre,
            target_lane=plan.target_lane,
            target_speed_mps=plan.target_speed_mps,
            headway_s=plan.headway_s,
            style=plan.style,
            reasoning=reasoning,
            say=plan.say,
        )

    def _refused(self, command: Command, why: str, key: str, now_ns: int, *, say: str = "") -> Reply:
        """`say`, or our sentence for `key` in the language last spoken."""
        self.figures["refused"] += 1
        return self._reply(command, "refused", now_ns, why=why, say=say or sentence(key, self._language))

    def _reply(
        self,
        command: Command,
        outcome: ReplyOutcome,
        now_ns: int,
        *,
        say: str = "",
        why: str = "",
        directive_id: int | None = None,
    ) -> Reply:
        return Reply(
            epoch=self.epoch,
            stamp_ns=now_ns,
            command_id=command.id,
            outcome=outcome,
            text=command.text[:TEXT_CHARS],
            say=say,
            why=why[:TEXT_CHARS],
            directive_id=directive_id,
        )


def _passed(intent: _Intent, scene: Scene) -> bool:
    """The car that the intent was about lies behind the ego, or is out of sight."""
    if intent.lead_id is None or intent.lead_id not in scene.positions:
        return True
    return scene.x_m - scene.positions[intent.lead_id] > scene.length_m + BEHIND_M
