"""The slow system's state machine: which command counts, what has become of it, and when to plan again.

Pure: no clock, no sockets, no asyncio. The shell passes the time in and carries the effects out. The newest command
wins; one interpretation is in flight; one command is pursued and outlives its directives until it is fulfilled,
cancelled, replaced or given up. Whatever was asked for, its directive is renewed before it expires. It is planned again
when its road changes: the car ahead is passed, the fast node delays the directive, the lane is clear again, a slow car
is ahead of somebody in a hurry. The same slots are planned for the present scene at once, by the rules of
`slow_node.planning.directive`, at most once in `REPLAN_EVERY_S`; the language model is asked again meanwhile.

An interpretation comes once, or twice: the quick reader's at once, `provisional`, and the language model's verdict on
it, which confirms, refines or withdraws what is being done, or is overruled. Nothing waits for it; once a newer command
has come it counts for nothing.

A command is a program (`slow_node.agenda`): its steps begin at once, one after the other, or when what they wait for
has come, which is watched at every scene from the end of the step before on, for a minute at most.

A hurry and a time gap stand on after they were fulfilled, without further replies: the next slow car is overtaken too,
and where the hurry took the ego to the left on a one-way road it is sent back to the right once that is free. All else
ends with its fulfilment: the fast node keeps the speed and the lane that it has reached.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from msgspec import structs

from schemas.runtime.clock import NS
from schemas.wire import topics
from schemas.wire.messages import Command, Event, EventKind, Reply, Verdict
from schemas.wire.program import Program
from slow_node.agenda import Agenda, watch
from slow_node.answers import Answers
from slow_node.attending import Attending
from slow_node.dialogue import Said, asked, follows, lacks_its_side, resolved, smaller, which_side
from slow_node.effects import Abandon, Effect, Interpret, Prefer
from slow_node.interpretation import Context, Interpretation
from slow_node.lessons import taken_back
from slow_node.memory.preferences import Manner
from slow_node.planning.directive import Refusal, directive_of, usual_directive
from slow_node.planning.program_text import brief
from slow_node.planning.replies import sentence
from slow_node.planning.scene import Scene
from slow_node.planning.spoken import place
from slow_node.pursuit import Pursuit
from slow_node.unanswered import Wish
from slow_node.understanding.reading.standing import is_only_standing, standing
from slow_node.understanding.reading.values import steps_of
from slow_node.understanding.slots import Slots

SCENE_MAX_AGE_S, SPARE_S = 10.0, 2.0
TURNS = 3
"""So many commands back go into a prompt."""


@dataclass(frozen=True)
class _Pending:
    id: int
    command: Command
    scene: Scene
    acted: bool = False
    """The reader's word is acted on; the model's is still to come."""
    again: str = ""
    """Why the model was asked once more."""

    @property
    def waits(self) -> bool:
        """Its passenger has no answer yet."""
        return not self.acted and not self.again


class Deliberation(Attending):
    """Commands, scenes, events and interpretations in; effects out."""

    def __init__(self, budget_s: float = 0.0, *, asks_again: bool = False) -> None:
        """budget_s: what an interpretation may take. One that took little longer counts. asks_again: whether the
        language model is asked once more when a directive is held up or its road turns."""
        super().__init__()
        self._asks_again = asks_again
        self._thinks_at_most_s = max(SCENE_MAX_AGE_S, budget_s + SPARE_S)
        self._held: Command | None = None
        """A command that came before the first observation."""
        self._pending: _Pending | None = None
        self._said: Said | None = None
        self._asked_for = self._asked_more = 0
        self._turns: tuple[str, ...] = ()
        """What was asked for last, in brief."""
        self._aside = ""
        """To be said with the reply to a command."""
        self._kept_for = -1
        """The id of the command that was kept as a preference, and asked for nothing else."""

    def open_wishes(self) -> list[Wish]:
        """Those whose passenger has not had the last reply."""
        agenda, pursuit = self._agenda, self._pursuit
        found = [
            *(
                [Wish(command=pursuit.command, language=pursuit.slots.language)]
                if pursuit and not pursuit.fulfilled
                else ()
            ),
            *([Wish(command=agenda.command, language=agenda.language)] if agenda and agenda.is_open else ()),
            *(
                [Wish(command=self._pending.command, language=self._language)]
                if self._pending and self._pending.waits
                else ()
            ),
            *([Wish(command=self._held, language=self._language)] if self._held else ()),
        ]
        return list({wish.command.id: wish for wish in found}.values())

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
            if self._pending.waits:
                say = sentence("superseded", self._language)
                old = self._pending.command
                effects.append(self._reply(old, "superseded", now_ns, say=say, why="a newer command came"))
            effects.append(Abandon())
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
        self._asked_for += 1
        self._pending = _Pending(self._asked_for, command, scene)
        before = self._pursuit
        held_up = before is not None and before.delayed_by and not before.fulfilled
        delayed = (before.directive.manoeuvre, before.delayed_by) if before is not None and held_up else ("", "")
        context = Context(self._turns, self._wishes(), *delayed)
        return [Interpret(self._asked_for, command.id, command.text, scene, context)]

    def _wishes(self) -> str:
        """What stands of the commands before, in brief."""
        program = self._standing()
        return "" if program is None else brief(program)

    def _standing(self) -> Program | None:
        agenda, pursuit = self._agenda, self._pursuit
        if agenda is not None and (pursuit is None or agenda.command.id == pursuit.command.id):
            return agenda.program if pursuit is not None or agenda.waiting() is not None else None
        return Program(outcome="directive", steps=steps_of(pursuit.slots)) if pursuit is not None else None

    def _asked_again(self, pursuit: Pursuit, what: str, scene: Scene) -> list[Effect]:
        """Ask the model about a command under way, unless it is thinking already. Its id is a negative one."""
        standing = self._standing()
        if not self._asks_again or self._pending is not None or pursuit.is_done or standing is None:
            return []
        self._asked_more += 1
        self._pending = _Pending(-self._asked_more, pursuit.command, scene, again=what)
        context = Context(
            self._turns[:-1], brief(standing), pursuit.directive.manoeuvre, pursuit.delayed_by, what, standing
        )
        return [Interpret(self._pending.id, pursuit.command.id, pursuit.command.text, scene, context)]

    def on_interpretation(self, identity: int, found: Interpretation, now_ns: int) -> list[Effect]:
        """One has ended: the gates, in order, are its schema, the road, and how old its scene is.

        One that was replaced meanwhile counts for nothing.
        """
        pending = self._pending
        if pending is None or pending.id != identity:
            return []
        if found.provisional:
            self._pending = replace(pending, acted=True)
            return self._act(pending, found, now_ns)
        self._pending = None
        if found.verdict == "withdrew" and not self._stands(pending.command):
            meant = found.slots.outcome if found.slots else "unclear"
            why = f"the language model said {meant!r}: nothing is left to be taken back"
            found = replace(found, verdict="overruled", why=why)
        if found.verdict == "refined" and pending.again and not self._can_be_refined(pending, found, now_ns):
            found = replace(found, verdict="overruled", why="what is under way stands")
        if found.verdict == "refined" and self._kept_for == pending.command.id:
            found = replace(found, verdict="overruled", why="what was said is kept as a preference")
        if found.verdict:
            self.metrics[found.verdict] = self.metrics.get(found.verdict, 0) + 1
        if pending.waits:
            return [self._judged(effect, found.verdict) for effect in self._act(pending, found, now_ns)]
        return self._second_thought(pending, found, now_ns)

    @staticmethod
    def _judged(effect: Effect, verdict: Verdict) -> Effect:
        return structs.replace(effect, verdict=verdict) if isinstance(effect, Reply) else effect

    def _second_thought(self, pending: _Pending, found: Interpretation, now_ns: int) -> list[Effect]:
        """The model has answered while the car did already what the reader has made of the command."""
        command = pending.command
        if found.verdict == "refined":
            return [self._judged(effect, "refined") for effect in self._act(pending, found, now_ns)]
        if found.verdict == "withdrew" and self._scene is not None:
            draft = usual_directive(self._scene, self._language)
            self._agenda = self._pursuit = None
            directive = self._directive(command, draft, self._scene, "the language model took it back", now_ns)
            why = f"the language model took it back: {found.slots.outcome if found.slots else 'unclear'}"
            said = directive_of(found.slots, self._scene) if found.slots is not None else None
            say = said.say if isinstance(said, Refusal) else sentence("unclear", self._language)
            return [directive, self._judged(self._refused(command, why, "", now_ns, say=say), "withdrew")]
        if pending.again:
            return []
        told = self._told[1] if self._told is not None and self._told[0] == command.id else "issued"
        return [self._judged(self._reply(command, told, now_ns, why=found.why), found.verdict)]

    def _can_be_refined(self, pending: _Pending, found: Interpretation, now_ns: int) -> bool:
        """Whether another answer about a wish under way changes it. Not once its first stage is done, nor where the
        answer goes by the wish before it, comes to the same, is late, or asks for what this road does not have."""
        agenda, standing = self._agenda, self._standing()
        scene, late = self._scene_of(pending, now_ns)
        if late or found.slots is None or standing is None or not self._stands(pending.command):
            return False
        steps = found.program.steps if found.program is not None else steps_of(found.slots)
        if found.lesson == "less":
            steps = smaller(steps)
        if (
            not steps
            or follows(steps)
            or steps == standing.steps
            or isinstance(directive_of(found.slots, scene), Refusal)
        ):
            return False
        return agenda is None or agenda.command.id != pending.command.id or agenda.at == 0

    def _stands(self, command: Command) -> bool:
        """Something of it is under way, or waits."""
        pursuit, agenda = self._pursuit, self._agenda
        under_way = pursuit is not None and pursuit.command.id == command.id and not pursuit.fulfilled
        return under_way or (agenda is not None and agenda.command.id == command.id and agenda.waits is not None)

    def _act(self, pending: _Pending, found: Interpretation, now_ns: int) -> list[Effect]:
        """Begin what a command was found to mean, or say why not."""
        command = pending.command
        if found.slots is None:
            if not found.model_answered:
                say = sentence("failed", self._language)
                return [self._reply(command, "failed", now_ns, why=found.why, say=say)]
            return [self._refused(command, found.why, "unclear", now_ns)]
        self._language = found.slots.language
        scene, late = self._scene_of(pending, now_ns)
        noted = self._noted(command, found.slots, scene, now_ns)
        program = found.program or Program(outcome=found.slots.outcome, steps=steps_of(found.slots))
        if noted and is_only_standing(command.text):
            self._kept_for = command.id
        if noted and (self._kept_for == command.id or program.outcome != "directive" or not program.steps):
            return [*noted, *self._go_on(command, scene, now_ns)]
        if program.question and not program.steps:
            self._said = asked(program.question, scene, self._said)
            say = Answers(scene, self._pursuit, self._agenda, self._language, program.miles).to(program.question)
            return [self._reply(command, "fulfilled", now_ns, say=say, why=f"a question: {program.question}")]
        if program.outcome == "unclear" and lacks_its_side(program.steps):
            say = sentence(which_side(scene), self._language, **place(scene))
            return [self._refused(command, "unclear command: left or right?", "", now_ns, say=say)]
        if follows(program.steps):
            steps = resolved(program.steps[0], self._said) if self._said is not None else ()
            if not steps and found.slots.outcome != "directive":
                why, key = ("no", "no_wish_before") if self._said is None else ("another kind of", "unclear")
                return [self._refused(command, f"unclear command: {why} wish before it to go by", key, now_ns)]
            if program.steps[0].act in ("less", "opposite"):
                noted += taken_back(self._said)
            program = structs.replace(program, outcome="directive", steps=steps or steps_of(found.slots))
        elif program.outcome != "directive" or not program.steps or found.slots.outcome != "directive":
            refusal = directive_of(found.slots, scene)
            if isinstance(refusal, Refusal):
                return [self._refused(command, found.why or refusal.why, "", now_ns, say=refusal.say)]
        if not program.steps:
            return [self._refused(command, found.why or "the answer asks for nothing", "unclear", now_ns)]
        if found.lesson == "less" and smaller(program.steps) != program.steps:
            program = structs.replace(program, steps=smaller(program.steps))
            self._aside = sentence("lesson_less", self._language)
        return [*noted, *self._undertake(command, program, found, scene, late, now_ns)]

    def _noted(self, command: Command, slots: Slots, scene: Scene, now_ns: int) -> list[Effect]:
        """What a command says for every drive is kept, or forgotten; and said so with the next reply."""
        self._aside = ""
        said = standing(command.text)
        if said is None or slots.outcome == "refused" or said.holds == (said.kind in self.manner.kinds):
            return []
        change = {said.kind}
        self.manner = Manner(self.manner.kinds | change if said.holds else self.manner.kinds - change)
        self._aside = sentence(f"prefers_{said.kind}" if said.holds else "prefers_no_more", self._language)
        return [Prefer(said.kind, command.text, said.holds)]

    def _go_on(self, command: Command, scene: Scene, now_ns: int) -> list[Effect]:
        """What is under way, or else normal driving, from now on in the passenger's new manner."""
        pursuit, what = self._pursuit, "as the passenger prefers"
        if pursuit is None:
            draft = structs.replace(usual_directive(scene), say="")
            effects: list[Effect] = [self._directive(command, draft, scene, what, now_ns)]
        else:
            effects = self._issue(*self._as_wished(pursuit, scene), scene, what, now_ns)
        return [*effects, self._reply(command, "fulfilled", now_ns, say=self._aside, why="a preference")]

    def _undertake(
        self, command: Command, program: Program, found: Interpretation, scene: Scene, late: bool, now_ns: int
    ) -> list[Effect]:
        """Begin a program's first stage, or wait for what it waits for."""
        when = program.steps[0].when
        waits = watch(when, scene, now_ns) if when is not None and when.kind != "done" else None
        agenda = Agenda(command, program, self._language, 0, waits)
        slots = self.manner.wished(agenda.asked(scene))
        if found.slots is not None and len(agenda.parts) == 1 and waits is None:
            slots = slots.model_copy(update={"say": found.slots.say, "reasoning": found.slots.reasoning})
        draft = directive_of(slots, scene)
        if isinstance(draft, Refusal):
            return [self._refused(command, found.why or draft.why, "", now_ns, say=draft.say)]
        if late:
            return [self._refused(command, "the answer came too late for its scene", "again", now_ns)]
        is_to_wait = waits is not None and not waits.due(scene, now_ns)
        if self._agenda is not None and self._agenda.command.id == command.id:
            self._agenda = None  # the same command, understood better
        dropped = self._drop_agenda("cancelled" if slots.cancel else "superseded", is_to_wait, now_ns)
        self._said = Said(program.steps, scene, command.text, slots)
        self._turns = (*self._turns, brief(program))[-TURNS:]
        if is_to_wait:
            self._agenda = agenda
            return [*dropped, *self._waiting(agenda, draft.say, now_ns)]
        self._agenda = agenda = agenda.under_way(scene, now_ns)
        say = " ".join(filter(None, (self._whole_of(agenda, draft.say, scene), self._aside)))
        draft = structs.replace(draft, say=say)
        return [*dropped, *self._begin(command, slots, found.why, scene, draft, now_ns, found.lesson)]

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
        usual = self._as_preferred(scene, now_ns) if before is None or before.epoch != scene.epoch else []
        if self._held is not None:
            held, self._held = self._held, None
            return [*usual, *self._ask(held, scene, now_ns)]
        if before is not None and before.epoch != scene.epoch:
            gone = self._agenda_in_new_world(scene, now_ns)
            pursuit = self._pursuit
            return [*usual, *gone, *(self._renew_in_new_world(pursuit, scene, now_ns) if pursuit is not None else ())]
        if self._agenda is not None and (due := self._look_after(self._agenda, scene, now_ns)):
            return due
        if self._pursuit is None or before is None:
            return usual
        return self._watch_over(self._pursuit, before, scene, now_ns)
