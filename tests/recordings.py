"""Recordings made by hand: messages into a file, a chunk a second, as the recorder writes them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from deploy.lab.lockstep import drive, overtake_at
from deploy.record.container import McapFile
from deploy.record.encoding import json_schema, to_json
from deploy.record.reader import METADATA
from fast_node.policies.load import load_policy
from schemas.runtime.clock import NS
from schemas.wire.messages import Action, Command, Message, Observation
from schemas.wire.topics import TOPICS
from sim_node.config import SimConfig
from sim_node.node import SimNode

OFFSET_NS = 10**18
"""Between CLOCK_MONOTONIC and the file's times."""
_NAMES: dict[type[Message], str] = {topic.type: topic.name for topic in TOPICS}


def write(path: Path, messages: Iterable[Message], *, finish: bool = True) -> Path:
    """A recording of these messages, each arriving when it was sent; not finished: as a killed recorder leaves it."""
    file = McapFile(path)
    file.add_metadata(METADATA, {"clock_offset_ns": str(OFFSET_NS), "policy": "fastslow"})
    channels = {topic.name: file.channel(f"/{topic.name}", topic.name, json_schema(topic.type)) for topic in TOPICS}
    cut_ns = 0
    for message in messages:
        at_ns = message.stamp_ns + OFFSET_NS
        file.add(channels[_NAMES[type(message)]], at_ns, at_ns, to_json(message))
        if message.stamp_ns - cut_ns >= NS:
            cut_ns = message.stamp_ns
            file.cut()
    file.cut()
    if finish:
        file.finish()
    else:
        file.close()
    return path


def driven(seconds: float, scenario: str = "two-way-case", policy: str = "fastslow") -> Iterator[Message]:
    """What a lock-step drive says, a passenger in a hurry from 0.4 s on."""
    ask = overtake_at(0.4)
    said = False
    for tick in drive(SimNode(SimConfig(scenario=scenario, seed=0)), load_policy(policy), ask, seconds):
        yield tick.observation
        if tick.directive is not None and not said:
            said = True
            stamp_ns = tick.observation.stamp_ns
            yield Command(epoch=tick.observation.epoch, stamp_ns=stamp_ns, id=1, text="overtake that car")
            yield tick.directive
        yield from tick.events
        yield tick.action


def without(messages: Iterable[Message], ticks: range) -> Iterator[Message]:
    """All but these ticks and their answers: a gap."""
    for message in messages:
        tick = message.tick if isinstance(message, Observation) else -1
        answers = message.answers_tick if isinstance(message, Action) else -1
        if tick not in ticks and answers not in ticks:
            yield message
