"""One command that is pursued to its end: its directive, and what its road asks for. Pure, as `deliberation` is."""

from __future__ import annotations

from dataclasses import dataclass, replace

from msgspec import structs

from schemas.driving.measures import INF
from schemas.runtime.clock import NS
from schemas.wire.messages import Command, Directive, ReplyOutcome
from slow_node.effects import Effect, Remember
from slow_node.lessons import gentler
from slow_node.planning.directive import (
    Refusal,
    asks_the_same,
    directive_of,
    hurried,
    may_take,
    on_this_road,
    onward_directive,
    return_directive,
    right_directive,
    slow_lead,
    usual_directive,
)
from slow_node.planning.replies import sentence
from slow_node.planning.scene import Scene
from slow_node.understanding.slots import Slots
from slow_node.voice import Voice

RENEW_BEFORE_S = 3.0
REPLAN_EVERY_S = 3.0
PURSUIT_MAX_S = 120.0
"""What has not come true by then is given up, rather than renewed for ever."""


@dataclass(frozen=True)
class Pursuit:
    """A command after it was understood, until it is fulfilled, cancelled, replaced or given up."""

    command: Command
    slots: Slots
    scene: Scene
    """In which it was understood."""
    directive: Directive
    """The newest that was sent, as far as it still stands."""
    began_ns: int
    directive_ids: frozenset[int]
    """All that were sent for it."""
    lead_id: int | None
    """The car that an overtake is about."""
    from_lane: int
    """The rightmost own lane that it was planned from: a hurry goes back as far as that."""
    fulfilled: bool = False
    """The passenger has had the last reply; what was asked for stands on."""
    reached: bool = False
    """What was asked for is so, and is to last."""
    returning: bool = False
    news: str = ""
    """Why to plan again, as soon as the rate allows."""
    planned_ns: int | None = None
    """When it was last planned again."""
    delayed_by: str = ""
    """The mask's reason that last delayed it."""
    min_ttc_s: float = INF
    lesson: str = ""
    """What experience on a road like this one says about it."""

    @property
    def hurried(self) -> bool:
        """It does not end with the next car."""
        return hurried(self.slots)

    def remembered(self, outcome: str, now_ns: int) -> Remember:
        """What came of it, for the memory."""
        came = f"{outcome}, held up by {self.delayed_by}" if self.delayed_by else outcome
        took_s = (now_ns - self.began_ns) / NS
        return Remember(self.command.text, self.scene, self.slots, came, took_s, self.min_ttc_s)

    @property
    def is_done(self) -> bool:
        """Nothing is left to come true."""
        return self.fulfilled or self.reached

    @property
    def overtakes(self) -> bool:
        return self.directive.manoeuvre == "overtake"

    def passed(self, scene: Scene) -> bool:
        """The car that it is about lies behind the ego, or is out of sight."""
        return scene.has_passed(self.lead_id)

    def news_from(self, before: Scene, scene: Scene) -> str:
        """What has changed on its road, or calls for more from a hurry; "" for nothing."""
        lane = self.directive.target_lane
        if self.overtakes and self.passed(scene) and not self.passed(before):
            return "the car ahead is passed"
        if lane is not None and lane != scene.ego_lane and lane in scene.free_lanes and lane not in before.free_lanes:
            return f"lane {lane} is clear again"
        if self.overtakes or not self.hurried:
            return ""
        if slow_lead(scene) and (self.fulfilled or scene.two_way):
            return "a slow car is ahead"
        if self._right_again(scene) and lane != scene.home_lane + 1:
            return "the right lane is free"
        if self._too_slow_there(scene):
            return "a slow car is on the right"
        return ""

    def planned_again(self, scene: Scene) -> Directive:
        """The directive for the same words on the road as it is now.

        What is relative to the moment it was said (left, slower, this gap), or half done, stays as it is.
        """
        kept = on_this_road(self.directive, scene)
        over = self.overtakes and scene.ego_lane == self.directive.target_lane
        if scene.borrowing or self.returning or over:
            return kept
        if self.overtakes or self.hurried:
            fresh = onward_directive(self.slots, scene) if self.fulfilled else directive_of(self.slots, scene)
            if isinstance(fresh, Directive) and fresh.manoeuvre == "overtake":
                return structs.replace(fresh, say="") if self.overtakes else fresh
        if not self.overtakes and self._right_again(scene):
            return right_directive(scene, self.slots.language)
        if not self.overtakes and self._too_slow_there(scene):
            return structs.replace(kept, target_lane=None)
        return kept

    def _right_again(self, scene: Scene) -> bool:
        """A hurry that is over its first car, one-way and farther left than it began, could keep right."""
        right = scene.home_lane + 1
        return (
            self.fulfilled
            and not scene.two_way
            and self.hurried
            and right <= self.from_lane
            and may_take(scene, right)
            and right in scene.free_lanes
            and right not in scene.slow_lanes
        )

    def _too_slow_there(self, scene: Scene) -> bool:
        """It was sent back to the right, has not gone yet, and would run up to a slow car there."""
        lane = self.directive.target_lane
        return self.fulfilled and self.hurried and lane == scene.home_lane + 1 and lane in scene.slow_lanes


class Pursuing(Voice):
    """Pursues one command: begins, plans again, renews in a new world, gives up."""

    def __init__(self) -> None:
        super().__init__()
        self._pursuit: Pursuit | None = None

    def _as_preferred(self, scene: Scene, now_ns: int) -> list[Effect]:
        """A drive begins in the passenger's manner, before anything is asked for."""
        if not self.manner.kinds - {"no_passing"} or self._pursuit is not None:
            return []
        nobody = Command(epoch=scene.epoch, stamp_ns=now_ns, id=0, text="")
        draft = structs.replace(usual_directive(scene), say="")
        return [self._directive(nobody, draft, scene, "as the passenger prefers", now_ns)]

    def _as_wished(self, pursuit: Pursuit, scene: Scene) -> tuple[Pursuit, Directive]:
        """A pursuit, and its directive, that overtakes no more unasked once the passenger prefers that."""
        slots = self.manner.wished(pursuit.slots)
        draft = pursuit.planned_again(scene)
        if slots != pursuit.slots and not scene.borrowing and not pursuit.returning:
            fresh = directive_of(slots, scene)
            draft = fresh if isinstance(fresh, Directive) else draft
        return replace(pursuit, slots=slots), structs.replace(draft, say="")

    def _watch_over(self, pursuit: Pursuit, before: Scene, scene: Scene, now_ns: int) -> list[Effect]:
        """What a new scene means for it: the end, the way back, another directive, or nothing."""
        pursuit = replace(pursuit, min_ttc_s=min(pursuit.min_ttc_s, scene.ttc_s))
        pursuit = self._pursuit = replace(pursuit, news=pursuit.news_from(before, scene) or pursuit.news)
        if not pursuit.is_done and not scene.borrowing and now_ns - pursuit.began_ns > PURSUIT_MAX_S * NS:
            return self._expire(pursuit, f"no chance within {PURSUIT_MAX_S:.0f} s", now_ns)
        if pursuit.overtakes and not pursuit.returning and scene.borrowing and pursuit.passed(scene):
            # At once: seconds spent waiting would be spent facing oncoming traffic.
            draft = return_directive(scene, pursuit.slots.language)
            return self._issue(replace(pursuit, returning=True), draft, scene, "the car ahead is passed", now_ns)
        if now_ns - pursuit.directive.stamp_ns > (pursuit.directive.ttl_s - RENEW_BEFORE_S) * NS:
            return self._issue(pursuit, pursuit.planned_again(scene), scene, "about to expire", now_ns)
        return self._plan_again(now_ns)

    def _begin(
        self, command: Command, slots: Slots, why: str, scene: Scene, draft: Directive, now_ns: int, lesson: str = ""
    ) -> list[Effect]:
        effects: list[Effect] = []
        old = self._pursuit
        if old is not None and not old.fulfilled and old.command.id != command.id:
            outcome: ReplyOutcome = "cancelled" if slots.cancel else "superseded"
            say = sentence(outcome, old.slots.language)
            effects.append(self._reply(old.command, outcome, now_ns, say=say, why="by a newer command"))
            if old.delayed_by:
                effects.append(old.remembered(outcome, now_ns))
        directive = self._directive(command, gentler(draft, lesson), scene, slots.reasoning, now_ns)
        lead_id, ids = scene.lead.id if scene.lead else None, frozenset({directive.id})
        self._pursuit = Pursuit(command, slots, scene, directive, now_ns, ids, lead_id, scene.home_lane, lesson=lesson)
        reply = self._reply(command, "issued", now_ns, directive_id=directive.id, say=directive.say, why=why)
        effects += [directive, reply]
        if slots.cancel:
            self._pursuit = None  # giving up is done with its directive: nothing to wait for
            effects.append(self._done(command, slots.language, directive.id, now_ns))
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
        again = self._asked_again(pursuit, what, scene)
        draft = self.manner.styled(gentler(pursuit.planned_again(scene), pursuit.lesson))
        if draft.manoeuvre != "overtake" and asks_the_same(draft, pursuit.directive):
            return again
        return [*self._issue(pursuit, draft, scene, what, now_ns), *again]

    def _asked_again(self, pursuit: Pursuit, what: str, scene: Scene) -> list[Effect]:
        """Have the language model think about the command once more; nothing waits for it."""
        return []

    def _issue(self, pursuit: Pursuit, draft: Directive, scene: Scene, what: str, now_ns: int) -> list[Effect]:
        """Another directive for the same command; a reply only where there is something to say, and none after the
        last.

        `what`: the reason for it, kept with the directive.
        """
        draft = gentler(draft, pursuit.lesson)
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
        if self._agenda is not None and self._agenda.command.id == pursuit.command.id:
            self._agenda = None
        if pursuit.fulfilled:
            return []
        say = sentence("expired", pursuit.slots.language)
        return [
            self._reply(pursuit.command, "expired", now_ns, say=say, why=why, directive_id=pursuit.directive.id),
            pursuit.remembered("expired", now_ns),
        ]
