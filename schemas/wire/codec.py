"""Typed encoders and decoders: a bad payload becomes a `Fault` with a reason, never a traceback."""

from __future__ import annotations

import unicodedata
from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from schemas.wire.bounds import OutOfBoundsError, check
from schemas.wire.messages import ROW_COLUMNS, SCHEMA_VERSION, Command, Message, Observation
from schemas.wire.text import plain
from schemas.wire.topics import MAX_COMMAND_CHARS, MAX_MESSAGE_BYTES, TOPICS, Topic

M = TypeVar("M", bound=Message)
_MAJOR = SCHEMA_VERSION.partition(".")[0]
_MOST: dict[type[Message], int] = {topic.type: topic.max_bytes for topic in TOPICS}
_encoder = msgspec.msgpack.Encoder()
_decoders: dict[type[Message], msgspec.msgpack.Decoder[Any]] = {}


_UNREADABLE = (msgspec.DecodeError, UnicodeDecodeError, RecursionError, OverflowError)


class _Header(msgspec.Struct):
    schema: str = SCHEMA_VERSION


class Fault(ValueError):  # noqa: N818 - a word of the contract, not a mistake of ours
    """A payload that cannot be used; `str()` says why in one line."""


def encode(message: Message) -> bytes:
    """MessagePack map of a message. Raises `Fault` if it would exceed its topic's `max_bytes`."""
    payload = _encoder.encode(message)
    most = _MOST.get(type(message), MAX_MESSAGE_BYTES)
    if len(payload) > most:
        raise Fault(f"{type(message).__name__} of {len(payload)} bytes exceeds {most}")
    return payload


def decode(topic: Topic[M], payload: bytes) -> M:
    """The message in a payload of `topic`.

    Raises `Fault` on anything else: too large, not MessagePack, a missing or ill-typed field, a number out of its
    bounds (`schemas.wire.bounds`), another schema major (naming both versions).
    """
    if len(payload) > topic.max_bytes:
        raise Fault(f"{len(payload)} bytes exceed {topic.max_bytes}")
    decoder = _decoders.get(topic.type)
    if decoder is None:
        decoder = _decoders[topic.type] = msgspec.msgpack.Decoder(topic.type)
    try:
        message: M = decoder.decode(payload)
    except _UNREADABLE as error:
        _refuse_another_major(_schema_of(payload))
        raise Fault(f"not a {topic.type.__name__}: {error}") from None
    _refuse_another_major(message.schema)
    try:
        check(message)
    except OutOfBoundsError as error:
        raise Fault(str(error)) from None
    return message


def is_readable(schema: str) -> bool:
    """Whether messages of that version are: those of our major."""
    return schema == SCHEMA_VERSION or schema.partition(".")[0] == _MAJOR


def _refuse_another_major(schema: str) -> None:
    if not is_readable(schema):
        raise Fault(f"schema {schema} is not readable here (this is {SCHEMA_VERSION})")


def _schema_of(payload: bytes) -> str:
    """The version that a payload names, whatever else is in it; ours if it names none."""
    try:
        return msgspec.msgpack.decode(payload, type=_Header).schema
    except _UNREADABLE:
        return SCHEMA_VERSION


def rows_of(observation: Observation) -> NDArray[np.float32]:
    """(V, 9) float32 view of an observation's rows; the ego is row 0. Columns: `schemas.wire.messages.ROW_COLUMNS`."""
    return np.frombuffer(observation.rows, np.float32).reshape(-1, len(ROW_COLUMNS))


def decode_command(payload: bytes, *, fallback_id: int, epoch: int, now_ns: int) -> Command:
    """A passenger's command: a `Command` struct, or plain UTF-8 text, which gets `fallback_id`.

    Raises `Fault` with a sentence for the passenger: empty, too long, or not text.
    """
    command: Command | None = None
    if payload[:1] and (payload[0] & 0xF0 == 0x80 or payload[0] in (0xDE, 0xDF)):  # a MessagePack map, never UTF-8 text
        try:
            command = msgspec.msgpack.decode(payload, type=Command)
        except _UNREADABLE:
            raise Fault("a command must be plain UTF-8 text") from None
    if command is None:
        try:
            text = payload.decode("utf-8")
        except UnicodeDecodeError:
            raise Fault("a command must be plain UTF-8 text") from None
        command = Command(id=fallback_id, epoch=epoch, stamp_ns=now_ns, text=text)
    text = command.text.strip()
    if not text:
        raise Fault("the command is empty")
    if len(text) > MAX_COMMAND_CHARS:
        raise Fault(f"the command has {len(text)} characters; {MAX_COMMAND_CHARS} is the most")
    if any(unicodedata.category(c) == "Cc" and c not in "\t\n\r" for c in text):
        raise Fault("the command contains control characters; plain text is needed")
    return msgspec.structs.replace(command, text=plain(text))
