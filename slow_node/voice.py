"""What the slow system says and sends: its replies, events and directives, with their ids. Pure."""

from __future__ import annotations

from msgspec import structs

from schemas.wire.messages import Command, Directive, Event, EventKind, Reply, ReplyOutcome
from schemas.wire.program import Trigger
from slow_node.agenda import Agenda, told
from slow_node.memory.preferences import Manner
from slow_node.planning.directive import issued
from slow_node.planning.replies import sentence
from slow_node.planning.scene import Scene

TEXT_CHARS = 200


class Voice:
    """Makes the messages of a deliberation."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._agenda: Agenda | None = None
        self._language = "en"
        self._last_id = 0
        self._told: tuple[int, ReplyOutcome] | None = None
        """The command that was answered last, and how."""
        self.manner = Manner()
        """The passenger's, on every drive."""
        self.metrics: dict[str, float] = {"commands": 0, "directives": 0, "refused": 0, "replans": 0}

    @property
    def epoch(self) -> int:
        return self._scene.epoch if self._scene else 0

    def _event(self, kind: EventKind, agenda: Agenda, trigger: Trigger, now_ns: int) -> Event:
        tick = self._scene.tick if self._scene else -1
        return Event(
            epoch=self.epoch,
            stamp_ns=now_ns,
            kind=kind,
            node="slow",
            tick=tick,
            command_id=agenda.command.id,
            detail=told(trigger),
        )

    def _done(self, command: Command, language: str, directive_id: int, now_ns: int) -> Reply:
        return self._reply(command, "fulfilled", now_ns, directive_id=directive_id, say=sentence("done", language))

    def _directive(self, command: Command, draft: Directive, scene: Scene, reasoning: str, now_ns: int) -> Directive:
        self._last_id = max(self._last_id + 1, now_ns // 1000)
        self.metrics["directives"] += 1
        draft = self.manner.styled(draft)
        agenda = self._agenda
        if agenda is not None and agenda.command.id == command.id and len(agenda.program.steps) > 1:
            waits_for = told(agenda.next_trigger) or (told(agenda.lasts.trigger) if agenda.lasts else "")
            draft = structs.replace(draft, steps=agenda.program.steps, step=agenda.first_step, waits_for=waits_for)
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
        waits: str = "",
    ) -> Reply:
        self._told = command.id, outcome
        return Reply(
            epoch=self.epoch,
            stamp_ns=now_ns,
            command_id=command.id,
            outcome=outcome,
            text=command.text[:TEXT_CHARS],
            say=say,
            why=why[:TEXT_CHARS],
            directive_id=directive_id,
            waits_for=waits,
        )
