"""What is said on the bus as channels of JSON messages, each with its schema: for recordings and viewers alike."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from deploy.record import scene
from deploy.record.encoding import json_schema, to_json
from schemas.runtime.bus import Arrival
from schemas.wire.codec import Fault, decode, decode_command
from schemas.wire.messages import Message, Observation
from schemas.wire.topics import COMMAND, TOPICS, Topic

_TOPICS: dict[str, Topic[Any]] = {topic.name: topic for topic in TOPICS}
_LATEST_NS = 2**64 - 1


class Channel(NamedTuple):
    """Where messages of one type go."""

    topic: str
    kind: str
    """The name of its schema."""
    schema: bytes
    """A JSON schema."""


CHANNELS = {
    topic.name: Channel(f"/{topic.name}", f"fastslow.{topic.type.__name__}", json_schema(topic.type))
    for topic in TOPICS
} | {name: Channel(name, kind, scene.SCHEMAS[kind]) for name, kind in scene.CHANNELS.items()}
"""By name: the bus's topics, and the scene that is drawn of an observation."""


class Translator:
    """Payloads of the bus to messages, and messages to what goes onto the channels."""

    def __init__(self, offset_ns: int) -> None:
        """offset_ns: from CLOCK_MONOTONIC to ns since 1970."""
        self._offset_ns = offset_ns
        self._scene = scene.Scene()
        self._epoch = 0

    def message(self, arrival: Arrival, now_ns: int) -> Message | None:
        """What came, seen at `now_ns` of CLOCK_MONOTONIC; a command may be plain text. None: it cannot be read."""
        topic = _TOPICS.get(arrival.topic)
        if topic is None:
            return None
        try:
            message: Message = decode(topic, arrival.payload)
            return message
        except Fault:
            if topic is not COMMAND:
                return None
        try:  # plain text
            return decode_command(arrival.payload, fallback_id=now_ns // 1000, epoch=self._epoch, now_ns=now_ns)
        except Fault:
            return None

    def sent_ns(self, message: Message) -> int:
        """When it was sent, in ns since 1970."""
        return min(max(message.stamp_ns + self._offset_ns, 0), _LATEST_NS)

    def parts(self, topic: str, message: Message) -> Iterator[tuple[str, bytes]]:
        """(channel's name, JSON): the message, and of an observation the scene."""
        yield topic, to_json(message)
        if isinstance(message, Observation):
            self._epoch = message.epoch
            yield from self._scene.draw(message, self.sent_ns(message))

    def redraw(self) -> None:
        """Draw the whole road with the next observation: somebody has come who has not seen it."""
        self._scene.forget()
