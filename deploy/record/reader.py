"""Recordings, read back: the messages that were on the bus, in the order in which they arrived."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import msgspec

from deploy.record.container import Contents, NotARecordingError, messages_of, scan
from deploy.record.encoding import from_json
from schemas.wire.codec import is_readable
from schemas.wire.messages import SCHEMA_VERSION, Message
from schemas.wire.topics import TOPICS, Topic

METADATA = "fastslow"
"""Name of the metadata record that says what was run."""
_TYPES: dict[str, Topic[Any]] = {f"/{topic.name}": topic for topic in TOPICS}


class Recording:
    """One recorded run. Times are ns since 1970; `clock_offset_ns` less is CLOCK_MONOTONIC, which messages carry."""

    def __init__(self, path: Path, contents: Contents) -> None:
        self.path = path
        self._contents = contents
        self.metadata = contents.metadata.get(METADATA, {})
        """What was run: seed, scenario, versions, options, as text."""
        self.start_ns = min((part.index.message_start_time for part in contents.parts), default=0)
        self.end_ns = max((part.index.message_end_time for part in contents.parts), default=0)
        self.finished = contents.finished
        """The recorder came to write the summary; otherwise it was killed, or still writes."""
        self.clock_offset_ns = int(self.metadata.get("clock_offset_ns", 0))

    def span_ns(self, topic: str) -> tuple[int, int] | None:
        """When the first message of a topic arrived, and when the last had: that is known to its chunk. None: no such.

        Raises `NotARecordingError` as `messages` does.
        """
        channels = {channel for channel, name in self._contents.channels.items() if name == f"/{topic}"}
        ends = [part.index.message_end_time for part in self._contents.parts if channels & part.counts.keys()]
        first = next(self.messages((topic,)), None)
        return None if first is None else (first[0], ends[-1])

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[tuple[int, str, Message]]:
        """(time of arrival, topic's name, message) for start_ns <= time < end_ns; `topics`: names, None for all.

        Raises `NotARecordingError` at a place that is damaged, or that holds messages of another program.
        """
        wanted = {
            channel: _TYPES[topic]
            for channel, topic in self._contents.channels.items()
            if topic in _TYPES and (topics is None or topic[1:] in topics)
        }
        with self.path.open("rb") as file:
            for part in self._contents.parts:
                index = part.index
                early = start_ns is not None and index.message_end_time < start_ns
                late = end_ns is not None and index.message_start_time >= end_ns
                if early or late or not wanted.keys() & part.counts.keys():
                    continue
                for channel, log_time, _, data in messages_of(part, file):
                    if (
                        channel in wanted
                        and (start_ns is None or log_time >= start_ns)
                        and (end_ns is None or log_time < end_ns)
                    ):
                        topic = wanted[channel]
                        yield log_time, topic.name, self._message(topic, data)

    def _message(self, topic: Topic[Any], data: bytes) -> Message:
        try:
            message: Message = from_json(topic.type, data)
        except (msgspec.MsgspecError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise NotARecordingError(f"{self.path} has a {topic.name} that this code cannot read: {error}") from None
        return message


def open_recording(path: Path) -> Recording:
    """The recording in `path`, whole or cut off.

    Raises `OSError`, or `NotARecordingError` for another kind of file, or messages of another major version.
    """
    with path.open("rb") as file:
        recording = Recording(path, scan(file))
    theirs = recording.metadata.get("protocol", SCHEMA_VERSION)
    if not is_readable(theirs):
        by = recording.metadata.get("revision") or recording.metadata.get("fastslow", "")
        raise NotARecordingError(
            f"its protocol is {theirs}, ours {SCHEMA_VERSION}: use the fastslow that recorded it ({by})"
        )
    return recording


__all__ = ["METADATA", "NotARecordingError", "Recording", "open_recording"]
