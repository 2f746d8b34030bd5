"""An MCAP file that can be cut off anywhere: written chunk by chunk, read to the last whole one, and continued.

The library's own writer cannot go on with a file that somebody left unfinished, nor give up a chunk that the disk has
no room for. So the file's records are the library's, and their order is ours: header, metadata, schemas and channels
come first, outside the chunks; then each chunk with its message indexes in one write; the summary comes at the end.
"""

from __future__ import annotations

import fcntl
import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.records import Message as Record

from schemas.runtime.process import ConfigError

MAGIC = b"\x89MCAP0\r\n"
COMPRESSION = "zstd"
_HEAD = struct.Struct("<BQ")
"""Of every record: opcode and length."""
_MESSAGE = struct.Struct("<HIQQ")
"""Of a message record: channel, sequence, log time, publish time; the data follows."""


class NotARecordingError(ConfigError):
    """The file is no MCAP file of ours, or is damaged; `str()` names it."""


@dataclass
class Part:
    """One chunk of a file."""

    index: ChunkIndex
    counts: dict[int, int]
    """Messages in it, by channel."""
    crc: int
    """Of its data, unpacked; 0: not known."""


@dataclass
class Contents:
    """What a file holds, down to its chunks."""

    header: list[Any] = field(default_factory=list)
    """Schemas and channels."""
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    metadata_indexes: list[MetadataIndex] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    end: int = 0
    """Offset behind the last whole record that is not of the summary."""
    finished: bool = False
    """The summary is there."""

    @property
    def channels(self) -> dict[int, str]:
        """Topic by channel id."""
        return {record.id: record.topic for record in self.header if isinstance(record, Channel)}


def scan(file: BinaryIO) -> Contents:
    """The contents of an open file, to its last whole chunk. Raises `NotARecordingError`."""
    file.seek(0, os.SEEK_END)
    size = file.tell()
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise NotARecordingError(f"{file.name} is not an MCAP file")
    found = Contents(end=len(MAGIC))
    while found.end + _HEAD.size <= size:
        file.seek(found.end)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        behind = found.end + _HEAD.size + length
        if behind > size:
            break
        if opcode == Opcode.DATA_END:
            file.seek(-len(MAGIC), os.SEEK_END)
            found.finished = file.read() == MAGIC
            break
        try:
            _note(found, opcode, behind - found.end, file)
        except (McapError, struct.error, UnicodeDecodeError):
            raise _damaged(file, found.end) from None
        found.end = behind
    if found.parts and not found.finished:
        _close_last(found, file, size)
    return found


def _note(found: Contents, opcode: int, length: int, file: BinaryIO) -> None:
    stream = ReadDataStream(file)
    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        found.header.append((Schema if opcode == Opcode.SCHEMA else Channel).read(stream))
    elif opcode == Opcode.METADATA:
        record = Metadata.read(stream)
        found.metadata[record.name] = record.metadata
        found.metadata_indexes.append(MetadataIndex(offset=found.end, length=length, name=record.name))
    elif opcode == Opcode.CHUNK:
        start, end, size, crc = struct.unpack("<QQQI", file.read(28))
        (name,) = struct.unpack("<I", file.read(4))
        index = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=found.end,
            compression=file.read(name).decode(),
            compressed_size=struct.unpack("<Q", file.read(8))[0],
            message_end_time=end,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=start,
            uncompressed_size=size,
        )
        found.parts.append(Part(index, {}, crc))
    elif opcode == Opcode.MESSAGE_INDEX and found.parts:
        channel, entries = struct.unpack("<HI", file.read(6))
        part = found.parts[-1]
        part.index.message_index_offsets[channel] = found.end
        part.index.message_index_length += length
        part.counts[channel] = entries // 16


def _close_last(found: Contents, file: BinaryIO, size: int) -> None:
    """The last chunk of an unfinished file counts only with all its message indexes."""
    last = found.parts[-1]
    try:
        whole = sum(last.counts.values()) == sum(1 for _ in messages_of(last, file))
    except NotARecordingError:
        whole = False
    if not whole:
        found.parts.pop()
        found.end = last.index.chunk_start_offset


def _damaged(file: BinaryIO, at: int) -> NotARecordingError:
    return NotARecordingError(f"{file.name} is damaged at byte {at}")


def messages_of(part: Part, file: BinaryIO) -> Iterator[tuple[int, int, int, bytes]]:
    """(channel, log time, publish time, data) of each message of a chunk, in the order of their writing.

    Raises `NotARecordingError` for a chunk that is not as it was written.
    """
    index = part.index
    if not 0 <= index.compressed_size <= index.chunk_length:
        raise _damaged(file, index.chunk_start_offset)
    file.seek(index.chunk_start_offset + index.chunk_length - index.compressed_size)
    data = file.read(index.compressed_size)
    try:
        if index.compression == COMPRESSION:
            data = zstandard.decompress(data, index.uncompressed_size)
    except (zstandard.ZstdError, MemoryError, OverflowError):
        raise _damaged(file, index.chunk_start_offset) from None
    if part.crc and zlib.crc32(data) != part.crc:
        raise _damaged(file, index.chunk_start_offset)
    at = 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if opcode == Opcode.MESSAGE:
            channel, _, log_time, publish_time = _MESSAGE.unpack_from(data, at)
            yield channel, log_time, publish_time, data[at + _MESSAGE.size : at + length]
        at += length


class McapFile:
    """A file being written, or continued. It holds a lock on it, so that nobody removes it meanwhile.

    Whatever fails with `OSError` leaves the file as it was before, readable, and without the messages of that chunk.
    """

    def __init__(self, path: Path) -> None:
        """Raises `OSError` if the file cannot be written, `NotARecordingError` if it is something else."""
        self._file = open(path, "a+b", buffering=0)  # noqa: SIM115 - as long as the recording
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._contents = Contents()
            self.fresh = os.fstat(self._file.fileno()).st_size < len(MAGIC)
            if self.fresh:
                os.ftruncate(self._file.fileno(), 0)
                head = RecordBuilder()
                Header("", "fastslow").write(head)
                self._append(MAGIC + head.end())
            else:
                self._contents = scan(self._file)
                os.ftruncate(self._file.fileno(), self._contents.end)
        except BaseException:
            self._file.close()
            raise
        self._channels = {topic: channel for channel, topic in self._contents.channels.items()}
        self._pending = RecordBuilder()
        self._indexes: dict[int, MessageIndex] = {}
        self._times: list[int] = []
        self._sequence: Counter[int] = Counter()
        self._compress = zstandard.ZstdCompressor(level=3)

    @property
    def size(self) -> int:
        """Bytes so far."""
        return self._contents.end

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """By name; of an older file what it has."""
        return self._contents.metadata

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Write a metadata record at once."""
        record = RecordBuilder()
        Metadata(name=name, metadata=data).write(record)
        index = MetadataIndex(offset=self._contents.end, length=record.count, name=name)
        self._append(record.end())
        self._contents.metadata[name] = data
        self._contents.metadata_indexes.append(index)

    def channel(self, topic: str, schema_name: str, schema: bytes) -> int:
        """The channel of a topic with JSON messages; written at once, if the file has none yet."""
        known = self._channels.get(topic)
        if known is not None:
            return known
        number = len(self._channels) + 1
        records = (
            Schema(id=number, data=schema, encoding="jsonschema", name=schema_name),
            Channel(id=number, topic=topic, message_encoding="json", metadata={}, schema_id=number),
        )
        builder = RecordBuilder()
        for record in records:
            record.write(builder)
        self._append(builder.end())
        self._contents.header += records
        self._channels[topic] = number
        return number

    def add(self, channel: int, log_time: int, publish_time: int, data: bytes) -> None:
        """Keep a message for the next chunk. Times in ns since 1970."""
        self._sequence[channel] += 1
        index = self._indexes.setdefault(channel, MessageIndex(channel_id=channel, records=[]))
        index.records.append((log_time, self._pending.count))
        self._times.append(log_time)
        Record(
            channel_id=channel,
            log_time=log_time,
            data=data,
            publish_time=publish_time,
            sequence=self._sequence[channel] & 0xFFFFFFFF,
        ).write(self._pending)

    def cut(self) -> None:
        """Write what was kept as a chunk."""
        if not self._times:
            return
        data, times, indexes = self._pending.end(), self._times, self._indexes
        self._times, self._indexes = [], {}
        squeezed = self._compress.compress(data)
        start, end = min(times), max(times)
        crc = zlib.crc32(data)
        out = RecordBuilder()
        Chunk(
            compression=COMPRESSION,
            data=squeezed,
            message_start_time=start,
            message_end_time=end,
            uncompressed_crc=crc,
            uncompressed_size=len(data),
        ).write(out)
        index = ChunkIndex(
            chunk_length=out.count,
            chunk_start_offset=self._contents.end,
            compression=COMPRESSION,
            compressed_size=len(squeezed),
            message_end_time=end,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=start,
            uncompressed_size=len(data),
        )
        for channel, messages in indexes.items():
            index.message_index_offsets[channel] = self._contents.end + out.count
            messages.write(out)
        index.message_index_length = out.count - index.chunk_length
        self._append(out.end())
        self._contents.parts.append(Part(index, {channel: len(m.records) for channel, m in indexes.items()}, crc))

    def finish(self) -> None:
        """Write the summary, and close. Where there is no room for it, the last chunks make some."""
        try:
            self.cut()
        except OSError:  # then without that chunk
            pass
        contents = self._contents
        while True:
            try:
                self._append(self._summary())
            except OSError:
                if not contents.parts:
                    self.close()
                    raise
                contents.end = contents.parts.pop().index.chunk_start_offset
                os.ftruncate(self._file.fileno(), contents.end)
            else:
                break
        self.close()

    def close(self) -> None:
        """Leave the file unfinished."""
        self._file.close()

    def _summary(self) -> bytes:
        contents = self._contents
        counts: Counter[int] = Counter()
        for part in contents.parts:
            counts.update(part.counts)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(contents.channels),
            channel_message_counts=dict(counts),
            chunk_count=len(contents.parts),
            message_count=counts.total(),
            message_end_time=max((part.index.message_end_time for part in contents.parts), default=0),
            message_start_time=min((part.index.message_start_time for part in contents.parts), default=0),
            metadata_count=len(contents.metadata_indexes),
            schema_count=len(contents.channels),
        )
        out = RecordBuilder()
        DataEnd(0).write(out)
        start = contents.end + out.count
        before = out.count
        for record in (
            *contents.header,
            statistics,
            *(part.index for part in contents.parts),
            *contents.metadata_indexes,
        ):
            record.write(out)
        data: bytes = out.end()
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0), zlib.crc32(data[before:]))
        Footer(summary_start=start, summary_offset_start=0, summary_crc=crc).write(out)
        footer: bytes = out.end()
        return data + footer + MAGIC

    def _append(self, data: bytes) -> None:
        """All of it or nothing."""
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            os.ftruncate(self._file.fileno(), self._contents.end)
            raise
        self._contents.end += len(data)
