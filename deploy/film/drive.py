"""A lock-step drive as pictures: one for every tick, with what was said and what became of it."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass

from deploy.film.writer import Picture
from deploy.lab.interpreter import running_interpreter
from deploy.lab.lockstep import drive
from fast_node.policies.policy import NamedPolicy
from schemas.driving.road import HZ
from schemas.wire.messages import Directive, Event, Observation
from sim_node.config import SimConfig
from sim_node.drawing import picture
from sim_node.node import SimNode
from slow_node.planning.directive import Refusal, directive_of, issued
from slow_node.planning.scene import encode_scene
from slow_node.understanding.slots import Slots

NOTE_S = 4.0
"""How long an event is shown."""


@dataclass(frozen=True)
class Words:
    """What the passenger says, and when [s]."""

    text: str
    at_s: float = 2.0


def pictures(
    config: SimConfig, policy: NamedPolicy, words: Words | None, duration_s: float, preset: str | None = None
) -> Iterator[Picture]:
    """Pictures of one episode, at the rate of the ticks. The words are understood offline, without a language model."""
    passenger, note, until = Passenger(words), "", -1
    for tick in drive(SimNode(config), policy, passenger.ask, duration_s, preset):
        k = tick.observation.tick
        if passenger.reply:
            note, until, passenger.reply = passenger.reply, k + round(NOTE_S * HZ), ""
        for event in tick.events:
            note, until = worded(event), k + round(NOTE_S * HZ)
        yield picture(tick.observation, tick.action, tick.directive, passenger.said, note if k < until else "")


class Passenger:
    """Somebody who says at most one thing, once, and is understood at once."""

    def __init__(self, words: Words | None) -> None:
        self._words = words
        self.said = ""
        """What has been said so far."""
        self.reply = ""
        """What the car answers to that."""

    def ask(self, observation: Observation, now_ns: int) -> Directive | None:
        """The directive that the words come to, at the tick at which they are said."""
        words = self._words
        if words is None or observation.tick != round(words.at_s * HZ):
            return None
        self.said = words.text
        scene = encode_scene(observation)
        with running_interpreter(ask="never", empty_bank=True) as interpreter:
            found = asyncio.run(interpreter.interpret(words.text, scene))
        planned = directive_of(found.slots or Slots(outcome="unclear"), scene)
        self.reply = planned.say
        if isinstance(planned, Refusal):
            return None
        return issued(planned, scene, command_id=1, directive_id=1, reasoning="", now_ns=now_ns)


def worded(event: Event) -> str:
    """An event in a few words."""
    why = f": {event.rule}" if event.rule and event.kind in ("delayed", "overridden") else ""
    car = f" (car {event.vehicle})" if why and event.vehicle >= 0 else ""
    return f"{str(event.kind).replace('_', ' ')}{why}{car}"
