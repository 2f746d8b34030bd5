"""What becomes of a program step by step: what it waits for, the next stage once its time has come, the end. Pure."""

from __future__ import annotations

from dataclasses import replace

from msgspec import structs

from schemas.wire.messages import EventKind, ReplyOutcome
from schemas.wire.program import Trigger
from slow_node.agenda import WAIT_MAX_S, Agenda, told
from slow_node.answers import lasts_sentence, waits_sentence
from slow_node.effects import Effect
from slow_node.planning.directive import Refusal, directive_of, usual_directive
from slow_node.planning.replies import sentence
from slow_node.planning.scene import Scene
from slow_node.planning.steps import slots_of
from slow_node.pursuit import Pursuing, Pursuit


class Attending(Pursuing):
    """Attends to an agenda beside the pursuit of the stage that is under way."""

    @staticmethod
    def _whole_of(agenda: Agenda, say: str, scene: Scene) -> str:
        """What is done now, until when, and what comes then."""
        said, language = [say], agenda.language
        if agenda.lasts is not None:
            said.append(lasts_sentence(agenda.lasts, scene, language, agenda.program.miles))
        for later in agenda.later:
            what = directive_of(slots_of(later, scene, language, agenda.program.miles), scene).say
            waits = later[0].when
            if waits is not None and waits.kind != "done":
                said.append(waits_sentence(waits, what, language, agenda.program.miles))
            else:
                said.append(sentence("then", language, what=what))
        return " ".join(part for part in said if part)

    def _waiting(self, agenda: Agenda, then: str, now_ns: int) -> list[Effect]:
        """Say what a command waits for, and what comes then."""
        trigger = agenda.waits.trigger if agenda.waits is not None else Trigger(kind="done")
        say = waits_sentence(trigger, then, agenda.language, agenda.program.miles)
        reply = self._reply(
            agenda.command, "heard", now_ns, say=say, why=f"waits for {told(trigger)}", waits=told(trigger)
        )
        return [reply, self._event(EventKind.WAITING, agenda, trigger, now_ns)]

    def _look_after(self, agenda: Agenda, scene: Scene, now_ns: int) -> list[Effect]:
        """What the agenda asks for now: a stage whose trigger has come, the end of one that lasts, giving up."""
        if agenda.waits is not None:
            if agenda.waits.due(scene, now_ns):
                return [
                    self._event(EventKind.DUE, agenda, agenda.waits.trigger, now_ns),
                    *self._next(agenda, scene, now_ns),
                ]
            if agenda.given_up(now_ns):
                self._agenda = None
                why = f"{told(agenda.waits.trigger)} did not come within {WAIT_MAX_S:.0f} s"
                say = sentence("waited_in_vain", agenda.language)
                return [self._reply(agenda.command, "expired", now_ns, why=why, say=say)]
            return []
        if agenda.lasts is None or not agenda.lasts.due(scene, now_ns):
            return []
        event = self._event(EventKind.DUE, agenda, agenda.lasts.trigger, now_ns)
        if agenda.next_trigger is not None:
            return [event, *self._move_on(agenda, scene, now_ns)]
        self._agenda, self._pursuit = None, None
        draft = usual_directive(scene, agenda.language)
        directive = self._directive(agenda.command, draft, scene, "its time is over", now_ns)
        return [event, directive, self._done(agenda.command, agenda.language, directive.id, now_ns)]

    def _agenda_in_new_world(self, scene: Scene, now_ns: int) -> list[Effect]:
        """What was waited for there does not come here; what is to last begins anew."""
        agenda = self._agenda
        if agenda is None:
            return []
        if agenda.waits is None:
            self._agenda = agenda.under_way(scene, now_ns)
            return []
        self._agenda = None
        if self._pursuit is not None and self._pursuit.command.id == agenda.command.id:
            self._pursuit = None
        say = sentence("waited_in_vain", agenda.language)
        return [self._reply(agenda.command, "expired", now_ns, why="the world was reset", say=say)]

    def _move_on(self, agenda: Agenda, scene: Scene, now_ns: int) -> list[Effect]:
        """From a stage that is done to the next one, at once or after what that waits for."""
        following = agenda.moved_on(scene, now_ns)
        if following is None:
            return []
        if following.waits is None or following.waits.due(scene, now_ns):
            return self._next(following, scene, now_ns)
        self._agenda = following
        return self._waiting(following, directive_of(following.asked(scene), scene).say, now_ns)

    def _next(self, agenda: Agenda, scene: Scene, now_ns: int) -> list[Effect]:
        """Begin the stage of an agenda."""
        slots = self.manner.wished(agenda.asked(scene))
        draft = directive_of(slots, scene)
        if isinstance(draft, Refusal):
            self._agenda = None
            return [self._reply(agenda.command, "failed", now_ns, why=draft.why, say=draft.say)]
        if agenda.has_named_lane and draft.target_lane is None and draft.manoeuvre in ("cruise", "follow"):
            draft = structs.replace(draft, target_lane=scene.kept_lane)  # what a step reached, the next one keeps
        self._agenda = agenda.under_way(scene, now_ns)
        return self._begin(agenda.command, slots, "", scene, draft, now_ns)

    def _fulfilled(self, pursuit: Pursuit, directive_id: int, now_ns: int) -> list[Effect]:
        """The passenger hears of it once; what stands on is held by a `cruise`, which the fast node goes on with."""
        scene, directive = self._scene, pursuit.directive
        if scene is None or (scene.borrowing and pursuit.overtakes):
            return []  # the first half is done; the manoeuvre ends on our own side of the road
        if pursuit.fulfilled and directive_id != directive.id:
            return []
        effects: list[Effect] = []
        agenda = self._agenda
        if agenda is not None and agenda.command.id == pursuit.command.id and not pursuit.fulfilled:
            if agenda.lasts is not None:  # it is done when it has lasted
                self._pursuit = replace(pursuit, reached=True)
                return []
            if agenda.next_trigger is not None:
                self._pursuit = replace(pursuit, fulfilled=True)
                return [pursuit.remembered("fulfilled", now_ns), *self._move_on(agenda, scene, now_ns)]
        if not pursuit.fulfilled:
            effects = [
                self._done(pursuit.command, pursuit.slots.language, directive_id, now_ns),
                pursuit.remembered("fulfilled", now_ns),
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

    def _drop_agenda(self, outcome: ReplyOutcome, is_to_wait: bool, now_ns: int) -> list[Effect]:
        """A newer command has come: what still waited is given up, and its passenger hears so once. What is under way
        goes on, without further replies, where the newer one is to wait."""
        agenda, pursuit = self._agenda, self._pursuit
        self._agenda = None
        if agenda is None or agenda.waiting() is None:
            return []
        if pursuit is not None and pursuit.command.id == agenda.command.id and not pursuit.fulfilled:
            if not is_to_wait:
                return []  # it hears so as the newer one begins
            self._pursuit = replace(pursuit, fulfilled=True)
        say = sentence(outcome, agenda.language)
        return [self._reply(agenda.command, outcome, now_ns, say=say, why="by a newer command")]
