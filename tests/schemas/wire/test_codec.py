"""What the codec refuses and in which words, and the last value on the good side of each of its limits."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from schemas.wire.codec import Fault, decode, decode_command, encode
from schemas.wire.messages import ROW_COLUMNS, ROW_LAYOUT, SCHEMA_VERSION, Command, Lane, Message, Observation
from schemas.wire.thought import Thought
from schemas.wire.topics import COMMAND, MAX_COMMAND_CHARS, MAX_MESSAGE_BYTES, OBSERVATION, THOUGHT, Topic

MAJOR = SCHEMA_VERSION[: SCHEMA_VERSION.index(".")]
NOT_TEXT = "a command must be plain UTF-8 text"


def command(text: str = "faster", **changes: Any) -> Command:
    return Command(**{"epoch": 3, "stamp_ns": 9, "id": 42, "text": text, **changes})


def observation(**changes: Any) -> Observation:
    fields = {
        "epoch": 1,
        "stamp_ns": 1,
        "tick": 5,
        "scenario": "two-way",
        "lanes": (Lane(y_m=0.0, start_m=0.0, end_m=500.0), Lane(y_m=4.0, start_m=0.0, end_m=500.0)),
        "rows": np.zeros(len(ROW_COLUMNS), np.float32).tobytes(),
    }
    return Observation(**{**fields, **changes})


def filled(size: int) -> Command:
    """A command whose encoding has `size` bytes."""
    return command("x" * (size - len(encode(command("x" * 1000))) + 1000))


def heard(payload: bytes) -> Command:
    return decode_command(payload, fallback_id=7, epoch=5, now_ns=11)


def as_map(message: Message) -> dict[str, Any]:
    fields: dict[str, Any] = msgspec.msgpack.decode(encode(message))
    return fields


def test_a_message_of_the_greatest_size_is_sent_and_read():
    payload = encode(filled(MAX_MESSAGE_BYTES))
    assert len(payload) == MAX_MESSAGE_BYTES
    assert decode(COMMAND, payload) == filled(MAX_MESSAGE_BYTES)


def test_a_message_of_one_byte_more_is_not_sent_and_its_type_and_size_are_named():
    with pytest.raises(Fault) as refused:
        encode(filled(MAX_MESSAGE_BYTES + 1))
    assert str(refused.value) == f"Command of {MAX_MESSAGE_BYTES + 1} bytes exceeds {MAX_MESSAGE_BYTES}"


def test_a_thought_may_be_as_long_as_its_topic_has_it_and_no_longer():
    def thought(size: int) -> Thought:
        plain = Thought(epoch=1, stamp_ns=1, command_id=1, command="", source="", outcome="", reading="x" * 5000)
        return msgspec.structs.replace(plain, reading="x" * (size - len(encode(plain)) + 5000))

    assert decode(THOUGHT, encode(thought(THOUGHT.max_bytes))) == thought(THOUGHT.max_bytes)
    with pytest.raises(Fault, match=f"^Thought of {THOUGHT.max_bytes + 1} bytes exceeds {THOUGHT.max_bytes}$"):
        encode(thought(THOUGHT.max_bytes + 1))


def test_a_payload_of_one_byte_more_is_not_read_even_where_it_is_a_message():
    payload = msgspec.msgpack.encode(filled(MAX_MESSAGE_BYTES + 1))
    with pytest.raises(Fault) as refused:
        decode(COMMAND, payload)
    assert str(refused.value) == f"{MAX_MESSAGE_BYTES + 1} bytes exceed {MAX_MESSAGE_BYTES}"


def test_a_payload_of_another_type_is_refused_naming_the_type_and_the_reason():
    with pytest.raises(Fault, match=r"^not a Command: .*`array`"):
        decode(COMMAND, msgspec.msgpack.encode([1, 2]))


def test_a_decoder_is_built_once_for_each_type(monkeypatch):
    class Late(Command, frozen=True, kw_only=True, tag="late"):
        """A type that no test has decoded yet."""

    built, build = [], msgspec.msgpack.Decoder

    def counted(kind: type[Message]) -> msgspec.msgpack.Decoder[Any]:
        built.append(kind)
        return build(kind)

    monkeypatch.setattr("msgspec.msgpack.Decoder", counted)
    topic = Topic(name="late", type=Late, hz=None, stale_after_s=1.0, depth=1)
    message = Late(epoch=1, stamp_ns=1, id=1, text="x")
    assert [decode(topic, encode(message)) for _ in range(3)] == [message] * 3
    assert built == [Late]


def test_a_version_in_three_parts_is_read_where_its_major_is_ours():
    newer = {**as_map(command()), "schema": f"{MAJOR}.99.1"}
    assert decode(COMMAND, msgspec.msgpack.encode(newer)).text == "faster"


def test_a_version_that_only_begins_like_ours_is_refused_naming_both():
    with pytest.raises(Fault) as refused:
        decode(COMMAND, msgspec.msgpack.encode({**as_map(command()), "schema": f"{MAJOR}0.0"}))
    assert str(refused.value) == f"schema {MAJOR}0.0 is not readable here (this is {SCHEMA_VERSION})"


def test_an_observation_of_one_row_that_aims_for_the_last_of_its_lanes_is_read():
    seen = observation(target_lane=1)
    assert decode(OBSERVATION, encode(seen)) == seen


ROW = 4 * len(ROW_COLUMNS)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"layout": "rows/9"}, f"row layout 'rows/9' is not {ROW_LAYOUT!r}"),
        ({"rows": b""}, f"rows of 0 bytes are not whole rows of {ROW}"),
        ({"rows": bytes(ROW + 4)}, f"rows of {ROW + 4} bytes are not whole rows of {ROW}"),
        ({"lanes": ()}, "an observation without lanes"),
        ({"rows": np.full(len(ROW_COLUMNS), math.inf, np.float32).tobytes()}, "a non-finite number in rows"),
        ({"target_speed_mps": math.inf}, "a non-finite set-point"),
        ({"acceleration_mps2": math.nan}, "a non-finite set-point"),
        ({"target_lane": 2}, "target_lane 2 is not one of 2 lanes"),
        ({"target_lane": -1}, "target_lane -1 is not one of 2 lanes"),
    ],
)
def test_an_observation_that_nobody_could_drive_by_is_refused_in_these_words(changes: dict[str, Any], why: str):
    with pytest.raises(Fault) as refused:
        decode(OBSERVATION, encode(observation(**changes)))
    assert str(refused.value) == why


N_FIELDS = len(as_map(command()))


@pytest.mark.parametrize(
    "header", [bytes([0x80 + N_FIELDS]), bytes([0xDE, 0, N_FIELDS]), bytes([0xDF, 0, 0, 0, N_FIELDS])]
)
def test_a_command_is_known_as_a_struct_by_each_of_the_headers_of_a_map(header: bytes):
    assert heard(header + encode(command())[1:]) == command()


def test_plain_text_gets_the_id_the_epoch_and_the_time_that_the_caller_gives():
    assert heard(b"faster") == Command(epoch=5, stamp_ns=11, id=7, text="faster")


def test_white_space_of_any_kind_becomes_one_space():
    assert heard(b"\r\nfaster,\t\n\r  please ").text == "faster, please"


def test_a_command_of_the_greatest_length_is_heard():
    assert heard(b" " + b"x" * MAX_COMMAND_CHARS + b"\n").text == "x" * MAX_COMMAND_CHARS


def test_marks_that_turn_the_direction_of_reading_are_left_out_of_a_command():
    assert heard("slower\u202e, faster\u2066".encode()).text == "slower, faster"


@pytest.mark.parametrize(
    ("payload", "why"),
    [
        (b"", "the command is empty"),
        (b" \t\r\n", "the command is empty"),
        (b"x" * 501, "the command has 501 characters; 500 is the most"),
        (b"fast\x1fer", "the command contains control characters; plain text is needed"),
        (b"fast\x7fer", "the command contains control characters; plain text is needed"),
        ("fast\x9b2Jer".encode(), "the command contains control characters; plain text is needed"),
        (b"\x90", NOT_TEXT),
        (b"\x80", NOT_TEXT),
        (b"\x8f\xff", NOT_TEXT),
        (b"\xde", NOT_TEXT),
        (b"\xdf\xc1", NOT_TEXT),
        (msgspec.msgpack.encode(command(" ")), "the command is empty"),
    ],
)
def test_a_command_that_nobody_could_follow_is_refused_in_these_words(payload: bytes, why: str):
    with pytest.raises(Fault) as refused:
        heard(payload)
    assert str(refused.value) == why
