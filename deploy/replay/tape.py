"""A recording in the order in which each node lived through it."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

from deploy.record.reader import Recording
from schemas.wire.journal import Journal
from schemas.wire.messages import Action, Control, Directive, Event, Observation, Reply, Status

World = list[Observation]
"""One epoch, tick by tick."""


@dataclass(frozen=True)
class Answered:
    """One step of the fast node."""

    observation: Observation
    directive: Directive | None
    action: Action
    arrived_ns: int
    """CLOCK_MONOTONIC when the observation was in its hands."""
    fresh: bool
    """The first step of a process."""


@dataclass
class Tape:
    """What was said in a run, by kind."""

    observations: dict[tuple[int, int], Observation] = field(default_factory=dict)
    """By epoch and tick."""
    actions: list[Action] = field(default_factory=list)
    """In the order of their sending."""
    directives: dict[int, Directive] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    """The fast node's, about directives."""
    orders: list[Control] = field(default_factory=list)
    """To begin another world."""
    replies: list[Reply] = field(default_factory=list)
    journals: list[Journal] = field(default_factory=list)
    """The slow node's inputs."""
    heartbeats: list[Status] = field(default_factory=list)
    """The fast node's."""

    @classmethod
    def of(cls, recording: Recording) -> Tape:
        """Read a recording once, from its beginning to its end."""
        tape = cls()
        for _, _, message in recording.messages():
            match message:
                case Observation():
                    tape.observations[message.epoch, message.tick] = message
                case Action():
                    tape.actions.append(message)
                case Directive():
                    tape.directives[message.id] = message
                case Event(node="fast"):
                    tape.events.append(message)
                case Control(do="restart"):
                    tape.orders.append(message)
                case Reply():
                    tape.replies.append(message)
                case Journal():
                    tape.journals.append(message)
                case Status(node="fast"):
                    tape.heartbeats.append(message)
        tape.actions.sort(key=lambda action: action.stamp_ns)
        return tape

    def worlds(self) -> list[World]:
        """The epochs, each from its first recorded tick."""
        found: dict[int, World] = {}
        for epoch, tick in sorted(self.observations):
            found.setdefault(epoch, []).append(self.observations[epoch, tick])
        return list(found.values())

    def gaps(self) -> dict[int, int]:
        """By epoch, the first tick that is not recorded although later ones are: what follows it hangs on it."""
        found = {}
        for world in self.worlds():
            if world[-1].tick != len(world) - 1:
                found[world[0].epoch] = next(n for n, seen in enumerate(world) if seen.tick != n)
        return found

    def answered(self) -> Iterator[Answered | Action]:
        """Every step of the fast node that can be taken again; an action alone where its inputs are not recorded."""
        fresh_at = self._starts()
        gaps = self.gaps()
        fresh = True
        for number, action in enumerate(self.actions):
            fresh = fresh or number in fresh_at
            observation = self.observations.get((action.epoch, action.answers_tick))
            directive = self.directives.get(action.directive_id) if action.directive_id is not None else None
            behind = action.answers_tick >= gaps.get(action.epoch, action.answers_tick + 1)
            if observation is None or behind or (directive is None) != (action.directive_id is None):
                yield action
                continue
            yield Answered(observation, directive, action, action.stamp_ns - action.compute_ns, fresh)
            fresh = False

    def _starts(self) -> set[int]:
        """Numbers of the actions that a new process sent first.

        A heartbeat tells of it some actions later, or just before the first. But a process that has died is not back
        before some ticks have gone unanswered: its first action is the one after the longest silence from the last
        heartbeat of the old process to the first action that follows the first one of the new.
        """
        starts = set()
        stamps = [action.stamp_ns for action in self.actions]
        for old, new in pairwise(self.heartbeats):
            if old.pid == new.pid:
                continue
            first, last = bisect_left(stamps, old.stamp_ns), bisect_right(stamps, new.stamp_ns)
            between = range(max(first, 1), min(last + 1, len(stamps)))
            if between:
                starts.add(max(between, key=lambda n: stamps[n] - stamps[n - 1]))
        return starts
