"""A lock-step drive as pictures: one for every tick, with what was said and what became of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from deploy.film.story import Story
from deploy.film.writer import Picture
from deploy.lab.interpreter import running_interpreter
from deploy.lab.lockstep import drive
from fast_node.policies.policy import NamedPolicy
from schemas.driving.road import HZ
from schemas.wire.messages import Command, Directive, Message, Observation, Reply, ReplyOutcome
from sim_node.config import SimConfig
from sim_node.node import SimNode
from slow_node.planning.directive import Refusal, directive_of, issued
from slow_node.planning.scene import encode_scene
from slow_node.understanding.slots import Slots


@dataclass(frozen=True)
class Words:
    """What the passenger says, and when [s]."""

    text: str
    at_s: float = 2.0


def pictures(
    config: SimConfig, policy: NamedPolicy, words: Words | None, duration_s: float, preset: str | None = None
) -> Iterator[Picture]:
    """Pictures of one episode, at the rate of the ticks. The words are understood offline, without a language model."""
    story = Story()
    passenger = Passenger(words, story.hear)
    for tick in drive(SimNode(config), policy, passenger.ask, duration_s, preset):
        for event in tick.events:
            story.hear(event)
        yield story.draw(tick.observation, tick.action)


class Passenger:
    """Somebody who says at most one thing, once, and is understood at once. `hear` gets all that is said."""

    def __init__(self, words: Words | None, hear: Callable[[Message], None]) -> None:
        self._words, self._hear = words, hear

    def ask(self, observation: Observation, now_ns: int) -> Directive | None:
        """The directive that the words come to, at the tick at which they are said."""
        words = self._words
        if words is None or observation.tick != round(words.at_s * HZ):
            return None
        scene = encode_scene(observation)
        with running_interpreter(ask="never", empty_bank=True) as interpreter:
            found = asyncio.run(interpreter.interpret(words.text, scene))
        planned = directive_of(found.slots or Slots(outcome="unclear"), scene)
        epoch, text = observation.epoch, words.text
        self._hear(Command(epoch=epoch, stamp_ns=now_ns, id=1, text=text))
        outcome: ReplyOutcome = "refused" if isinstance(planned, Refusal) else "issued"
        self._hear(Reply(epoch=epoch, stamp_ns=now_ns, command_id=1, outcome=outcome, text=text, say=planned.say))
        if isinstance(planned, Refusal):
            return None
        directive = issued(planned, scene, command_id=1, directive_id=1, reasoning="", now_ns=now_ns)
        self._hear(directive)
        return directive
