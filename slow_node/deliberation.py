"""The slow system's state machine: which command counts, what has become of it, and when to plan again.

Pure: no clock, no sockets, no asyncio. The shell passes the time in and carries the effects out. The newest command
wins; one interpretation is in flight; one command is pursued and outlives its directives until it is fulfilled,
cancelled, replaced or given up. Whatever was asked for, its directive is renewed before it expires. It is planned again
when its road changes: the car ahead is passed, the fast node delays the directive, the lane is clear again, a slow car
is ahead of somebody in a hurry. The words have not changed then, so no model is asked: the same slots are planned for
the present scene, by the rules of `slow_node.planning.directive`, at most once in `REPLAN_EVERY_S`.

A hurry and a time gap stand on after they were fulfilled, without further replies: the next slow car is overtaken too,
and where the hurry took the ego to the left on a one-way road it is sent back to the right once that is free. All else
ends with its fulfilment: the fast node keeps the speed and the lane that it has reached.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from msgspec import structs

from schemas.driving.measures import INF
from schemas.runtime.clock import NS
from schemas.wire import topics
from schemas.wire.messages import Command, Directive, Event, EventKind, Reply, ReplyOutcome
from slow_node.interpreter import Interpretation
from slow_node.planning.directive import Refusal, asks_the_same, directive_of, issued, return_directive
from slow_node.planning.replies import sentence
from slow_node.planning.scene import Scene
from slow_node.pursuit import Pursuit
from slow_node.understanding.slots import Slots

SCENE_MAX_AGE_S, SPARE_S = 10.0, 2.0
RENEW_BEFORE_S = 3.0
REPLAN_EVERY_S = 3.0
PURSUIT_MAX_S = 120.0
"""What has not come true by then is given up, rather than renewed for ever."""
TEXT_CHARS = 200


@dataclass(frozen=True)
class Interpret:
    """Effect: find out what a command means. At most one is in flight; a newer one replaces it."""

    id: int
    command: str
    scene: Scene
    delayed: str = ""
    """The manoeuvre before it that the fast node is delaying; "" where there is none."""
    delayed_by: str = ""
    """The rule by which it does."""


@dataclass(frozen=True)
class Abandon:
    """Effect: the interpretation in flight is of no use any more."""


@dataclass(frozen=True)
class Remember:
    """Effect: keep a decision and what came of it in the memory bank."""

    command: str
    scene: Scene
    slots: Slots
    outcome: str
    """"fulfilled", "expired", "superseded" or "cancelled"; with the reason that held it up, where one did."""
    took_s: float
    """From the directive to its end."""
    min_ttc_s: float
    """Smallest time to collision meanwhile (`Scene.ttc_s`); inf: the ego never closed in on anybody."""


Effect = Interpret | Abandon | Remember | Directive | Reply


@dataclass(frozen=True)
class _Pending:
    id: int
    command: Command
    scene: Scene


class Deliberation:
    """Commands, scenes, events and interpretations in; effects out."""

    def __init__(self, budget_s: float = 0.0) -> None:
        """budget_s: what an interpretation may take. One that took little longer counts."""
        self._thinks_at_most_s = max(SCENE_MAX_AGE_S, budget_s + SPARE_S)
        self._scene: Scene | None = None
        self._held: Command | None = None
        """A command that came before the first observation."""
        self._pending: _Pending | None = None
        self._pursuit: Pursuit | None = None
        self._language = "en"
        self._last_id = 0
        self._asked = 0
        self.metrics: dict[str, float] = {"commands": 0, "directives": 0, "refused": 0, "replans": 0}

    @property
    def epoch(self) -> int:
        return self._scene.epoch if self._scene else 0

    def refuse_payload(self, why: str, command_id: int, now_ns: int) -> list[Effect]:
        """A payload that is no command."""
        self.metrics["commands"] += 1
        self.metrics["refused"] += 1
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
        """Heard at once; whatever was being interpreted is superseded. A command out of the past is not obeyed."""
        self.metrics["commands"] += 1
        age_s = (now_ns - command.stamp_ns) / NS
        if age_s > topics.COMMAND.stale_after_s:
            return [self._refused(command, f"the command came {age_s:.0f} s late", "again", now_ns)]
        effects: list[Effect] = [self._reply(command, "heard", now_ns)]
        if self._pending is not None:
            say = sentence("superseded", self._language)
            effects += [
                self._reply(self._pending.command, "superseded", now_ns, say=say, why="a newer command came"),
                Abandon(),
            ]
            self._pending = None
        if self._scene is None:
            if self._held is not None:
                say = sentence("superseded", self._language)
                effects.append(self._reply(self._held, "superseded", now_ns, say=say, why="a newer command came"))
            self._held = command
            return effects
        return effects + self._ask(command, self._scene, now_ns)

    def _ask(self, command: Command, scene: Scene, now_ns: int) -> list[Effect]:
        """Have a command interpreted on this scene."""
        if now_ns - scene.stamp_ns > SCENE_MAX_AGE_S * NS:
            why = "the car's surroundings are unknown: no recent observation"
            return [self._refused(command, why, "blind", now_ns)]
        self._asked += 1
        self._pending = _Pending(self._asked, command, scene)
        before = self._pursuit
        if before is not None and before.delayed_by and not before.fulfilled:
            delayed = before.directive.manoeuvre
            return [Interpret(self._asked, command.text, scene, delayed, before.delayed_by)]
        return [Interpret(self._asked, command.text, scene)]

    def on_interpretation(self, identity: int, found: Interpretation, now_ns: int) -> list[Effect]:
        """One has ended: the gates, in order, are its schema, the road, and how old its scene is.

        One that was replaced meanwhile counts for nothing.
        """
        pending = self._pending
        if pending is None or pending.id != identity:
            return []
        self._pending = None
        command = pending.command
        if found.slots is None:
            if not found.model_answered:
                say = sentence("failed", self._language)
                return [self._reply(command, "failed", now_ns, why=found.why, say=say)]
            return [self._refused(command, found.why, "unclear", now_ns)]
        self._language = found.slots.language
        scene, late = self._scene_of(pending, now_ns)
        draft = directive_of(found.slots, scene)
        if isinstance(draft, Refusal):
            return [self._refused(command, found.why or draft.why, "", now_ns, say=draft.say)]
        if late:
            return [self._refused(command, "the answer came too late for its scene", "again", now_ns)]
        return self._begin(command, found.slots, found.why, scene, draft, now_ns)

    def _scene_of(self, pending: _Pending, now_ns: int) -> tuple[Scene, bool]:
        """The scene to plan an answer for, and whether it came too late.

        After a reset of the world, or long thoughts, the command stands and its scene does not.
        """
        thought, newest = pending.scene, self._scene or pending.scene
        old = now_ns - thought.stamp_ns > SCENE_MAX_AGE_S * NS
        scene = newest if newest.epoch != thought.epoch or old else thought
        too_long = newest.epoch == thought.epoch and now_ns - thought.stamp_ns > self._thinks_at_most_s * NS
        return scene, too_long or now_ns - scene.stamp_ns > SCENE_MAX_AGE_S * NS

    def on_event(self, event: Event, now_ns: int) -> list[Effect]:
        """What the fast node reports about the pursuit's directives. An expired one is renewed by the next scene."""
        pursuit = self._pursuit
        if pursuit is None or event.epoch != self.epoch or event.directive_id not in pursuit.directive_ids:
            return []
        if event.kind == EventKind.FULFILLED:
            return self._fulfilled(pursuit, event.directive_id, now_ns)
        if event.kind == EventKind.DELAYED and event.directive_id == pursuit.directive.id:
            self._pursuit = replace(
                pursuit,
                delayed_by=event.reason or pursuit.delayed_by,
                news=f"delayed by the fast system ({event.reason or 'safety'})",
            )
            return self._plan_again(now_ns)
        return []

    def on_scene(self, scene: Scene, now_ns: int) -> list[Effect]:
        """A new observation: begin with the command that has waited for it, and watch over the pursuit."""
        before, self._scene = self._scene, scene
        if self._held is not None:
            held, self._held = self._held, None
            return self._ask(held, scene, now_ns)
        pursuit = self._pursuit
        if pursuit is None:
            return []
        if before is None or before.epoch != scene.epoch:
            return self._renew_in_new_world(pursuit, scene, now_ns)
        pursuit = replace(pursuit, min_ttc_s=min(pursuit.min_ttc_s, scene.ttc_s))
        pursuit = self._pursuit = replace(pursuit, news=pursuit.news_from(before, scene) or pursuit.news)
        if not pursuit.fulfilled and not scene.borrowing and now_ns - pursuit.began_ns > PURSUIT_MAX_S * NS:
            return self._expire(pursuit, f"no chance within {PURSUIT_MAX_S:.0f} s", now_ns)
        if pursuit.overtakes and not pursuit.returning and scene.borrowing and pursuit.passed(scene):
            # At once: seconds spent waiting would be spent facing oncoming traffic.
            draft = return_directive(scene, pursuit.slots.language)
            return self._issue(replace(pursuit, returning=True), draft, scene, "the car ahead is passed", now_ns)
        if now_ns - pursuit.directive.stamp_ns > (pursuit.directive.ttl_s - RENEW_BEFORE_S) * NS:
            return self._issue(pursuit, pursuit.planned_again(scene), scene, "about to expire", now_ns)
        return self._plan_again(now_ns)

    def _begin(
        self, command: Command, slots: Slots, why: str, scene: Scene, draft: Directive, now_ns: int
    ) -> list[Effect]:
        effects: list[Effect] = []
        old = self._pursuit
        if old is not None and not old.fulfilled:
            outcome: ReplyOutcome = "cancelled" if slots.cancel else "superseded"
            say = sentence(outcome, old.slots.language)
            effects.append(self._reply(old.command, outcome, now_ns, say=say, why="by a newer command"))
            if old.delayed_by:
                effects.append(self._remember(old, outcome, now_ns))
        directive = self._directive(command, draft, scene, slots.reasoning, now_ns)
        lead_id = scene.lead.id if scene.lead else None
        self._pursuit = Pursuit(
            command, slots, scene, directive, now_ns, frozenset({directive.id}), lead_id, scene.home_lane
        )
        reply = self._reply(command, "issued", now_ns, directive_id=directive.id, say=directive.say, why=why)
        effects += [directive, reply]
        if slots.cancel:
            self._pursuit = None  # giving up is done with its directive: nothing to wait for
            effects.append(self._done(command, slots, directive.id, now_ns))
        return effects

    def _fulfilled(self, pursuit: Pursuit, directive_id: int, now_ns: int) -> list[Effect]:
        """The passenger hears of it once; what stands on is held by a `cruise`, which the fast node goes on with."""
        scene, directive = self._scene, pursuit.directive
        if scene is None or (scene.borrowing and pursuit.overtakes):
            return []  # the first half is done; the manoeuvre ends on our own side of the road
        if pursuit.fulfilled and directive_id != directive.id:
            return []
        effects: list[Effect] = []
        if not pursuit.fulfilled:
            effects = [
                self._done(pursuit.command, pursuit.slots, directive_id, now_ns),
                self._remember(pursuit, "fulfilled", now_ns),
            ]
        if not pursuit.hurried and directive.headway_s is None:
            self._pursuit = None
            return effects
        pursuit = replace(pursuit, fulfilled=True, returning=False, news="")
        held = structs.replace(directive, manoeuvre="cruise", say="")
        if directive.manoeuvre == "follow":
            return [*effects, *self._issue(pursuit, held, scene, "held", now_ns)]
        if pursuit.overtakes:
            held = structs.replace(held, target_lane=None, headway_s=None, style="normal")
            pursuit = replace(pursuit, directive=held)
        self._pursuit = pursuit
        return effects

    def _plan_again(self, now_ns: int) -> list[Effect]:
        """Plan for what is new, at a bounded rate; in the middle of a manoeuvre on the wrong side never.

        A directive that stays the same is not sent again: the fast node would forget how long it has been waiting. An
        overtake it knows for the same manoeuvre, and carries on.
        """
        pursuit, scene = self._pursuit, self._scene
        if pursuit is None or scene is None or not pursuit.news:
            return []
        if pursuit.planned_ns is not None and now_ns - pursuit.planned_ns < REPLAN_EVERY_S * NS:
            return []
        what = pursuit.news
        pursuit = self._pursuit = replace(pursuit, news="")
        if scene.borrowing or pursuit.returning:
            return []
        self.metrics["replans"] += 1
        pursuit = self._pursuit = replace(pursuit, planned_ns=now_ns)
        draft = pursuit.planned_again(scene)
        if draft.manoeuvre != "overtake" and asks_the_same(draft, pursuit.directive):
            return []
        return self._issue(pursuit, draft, scene, what, now_ns)

    def _issue(self, pursuit: Pursuit, draft: Directive, scene: Scene, what: str, now_ns: int) -> list[Effect]:
        """Another directive for the same command; a reply only where there is something to say, and none after the
        last.

        `what`: the reason for it, kept with the directive.
        """
        directive = self._directive(pursuit.command, draft, scene, f"again: {what}", now_ns)
        lead_id = pursuit.lead_id
        if directive.manoeuvre == "overtake" and not scene.borrowing and scene.lead is not None:
            lead_id = scene.lead.id
        ids = frozenset({directive.id}) if pursuit.fulfilled else pursuit.directive_ids | {directive.id}
        self._pursuit = replace(
            pursuit,
            directive=directive,
            directive_ids=ids,
            lead_id=lead_id,
            from_lane=max(pursuit.from_lane, scene.home_lane),
        )
        if not directive.say or pursuit.fulfilled:
            return [directive]
        reply = self._reply(pursuit.command, "issued", now_ns, directive_id=directive.id, say=directive.say)
        return [directive, reply]

    def _renew_in_new_world(self, pursuit: Pursuit, scene: Scene, now_ns: int) -> list[Effect]:
        draft = directive_of(pursuit.slots, scene)
        if isinstance(draft, Refusal):
            return self._expire(pursuit, f"the world was reset: {draft.why}", now_ns)
        fresh = replace(
            pursuit,
            began_ns=now_ns,
            scene=scene,
            lead_id=scene.lead.id if scene.lead else None,
            from_lane=scene.home_lane,
            returning=False,
            news="",
            min_ttc_s=INF,
        )
        return self._issue(fresh, structs.replace(draft, say=""), scene, "the world was reset", now_ns)

    def _expire(self, pursuit: Pursuit, why: str, now_ns: int) -> list[Effect]:
        self._pursuit = None
        if pursuit.fulfilled:
            return []
        say = sentence("expired", pursuit.slots.language)
        return [
            self._reply(pursuit.command, "expired", now_ns, say=say, why=why, directive_id=pursuit.directive.id),
            self._remember(pursuit, "expired", now_ns),
        ]

    def _done(self, command: Command, slots: Slots, directive_id: int, now_ns: int) -> Reply:
        return self._reply(
            command, "fulfilled", now_ns, directive_id=directive_id, say=sentence("done", slots.language)
        )

    @staticmethod
    def _remember(pursuit: Pursuit, outcome: str, now_ns: int) -> Remember:
        came = f"{outcome}, held up by {pursuit.delayed_by}" if pursuit.delayed_by else outcome
        took_s = (now_ns - pursuit.began_ns) / NS
        return Remember(pursuit.command.text, pursuit.scene, pursuit.slots, came, took_s, pursuit.min_ttc_s)

    def _directive(self, command: Command, draft: Directive, scene: Scene, reasoning: str, now_ns: int) -> Directive:
        self._last_id = max(self._last_id + 1, now_ns // 1000)
        self.metrics["directives"] += 1
        return issued(draft, scene, command.id, self._last_id, reasoning, now_ns)

    def _refused(self, command: Command, why: str, key: str, now_ns: int, *, say: str = "") -> Reply:
        """`say`, or our sentence for `key` in the language last spoken."""
        self.metrics["refused"] += 1
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
