"""The contract: what is written can be read, and nothing that arrives raises anything but a `Fault`."""

from __future__ import annotations

import base64
import json
import math
import string
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from schemas.wire import messages as m
from schemas.wire.codec import Fault, decode, decode_command, encode, rows_of
from schemas.wire.journal import Found, Input, Journal
from schemas.wire.thought import Recalled, Thought, Try, Turn
from schemas.wire.topics import (
    ACTION,
    DIRECTIVE,
    EVENT,
    MAX_COMMAND_CHARS,
    MAX_MESSAGE_BYTES,
    OBSERVATION,
    TOPICS,
    Topic,
)
from tests import scenes

CALM = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""The first texts are slow to make, and the machine may be busy: neither is a finding."""

WIDTH = len(m.ROW_COLUMNS)
ANY_TOPIC = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
numbers = st.floats(-1e6, 1e6, width=32)
speeds = st.floats(0.0, 150.0, width=32)
counts = st.integers(0, 2**48)
words = st.text(max_size=40)


def observation(vehicles: int = 3, **changes: Any) -> m.Observation:
    table = np.arange(vehicles * WIDTH, dtype=np.float32).reshape(vehicles, WIDTH)
    table[:, -1] %= 2
    rows = table.tolist()
    return scenes.observation(*rows, **{"tick": 5, "target_lane": 0, **changes})


header = {"epoch": counts, "stamp_ns": counts}
STRATEGIES: dict[str, st.SearchStrategy[m.Message]] = {
    "observation": st.builds(observation, vehicles=st.integers(1, 16), tick=counts, **header),
    "action": st.builds(
        m.Action,
        answers_tick=counts,
        meta_action=st.sampled_from([int(a) for a in m.MetaAction]),
        source=st.sampled_from(["policy", "masked", "coordination", "fallback"]),
        compute_ns=counts,
        why=words,
        speed_goal_mps=st.none() | speeds,
        directive_id=st.none() | counts,
        probabilities=st.lists(numbers, max_size=5).map(tuple),
        closed=st.lists(
            st.builds(m.Closure, action=st.integers(0, 5), reason=st.sampled_from(m.Reason)), max_size=6
        ).map(tuple),
        **header,
    ),
    "directive": st.builds(
        m.Directive,
        id=counts,
        command_id=counts,
        scene_tick=counts,
        target_lane=st.none() | st.integers(0, 9),
        target_speed_mps=st.none() | speeds,
        manoeuvre=st.sampled_from(["cruise", "overtake", "stop"]),
        reasoning=st.text(max_size=200),
        say=words,
        **header,
    ),
    "command": st.builds(m.Command, id=counts, text=st.text(max_size=MAX_COMMAND_CHARS), **header),
    "reply": st.builds(
        m.Reply,
        command_id=counts,
        outcome=st.sampled_from(["heard", "refused", "fulfilled"]),
        text=st.text(max_size=200),
        say=words,
        why=words,
        **header,
    ),
    "event": st.builds(
        m.Event,
        kind=st.sampled_from(m.EventKind),
        node=words,
        tick=counts,
        reason=st.none() | st.sampled_from(m.Reason),
        detail=words,
        **header,
    ),
    "status": st.builds(
        m.Status,
        node=words,
        pid=counts,
        seq=counts,
        state=st.sampled_from(["ready", "stopping"]),
        metrics=st.dictionaries(st.text(string.ascii_lowercase, max_size=12), numbers, max_size=12),
        **header,
    ),
    "thought": st.builds(
        Thought,
        command_id=counts,
        command=words,
        source=words,
        outcome=words,
        prompt=st.lists(st.builds(Turn, role=words, content=st.text(max_size=500)), max_size=5).map(tuple),
        recalled=st.lists(
            st.builds(Recalled, command=words, similarity=numbers, slots=words, outcome=words), max_size=5
        ).map(tuple),
        answers=st.lists(st.text(max_size=300), max_size=2).map(tuple),
        spans_ms=st.dictionaries(words, numbers, max_size=3),
        tries=st.lists(
            st.builds(Try, ms=numbers, asked=words, failed=words, unusable=words, thinking=words), max_size=3
        ).map(tuple),
        cost_usd=st.none() | numbers,
        **header,
    ),
    "control": st.builds(
        m.Control,
        do=st.sampled_from(["pause", "resume", "step", "restart"]),
        scenario=words,
        seed=st.none() | counts,
        density=st.none() | numbers,
        **header,
    ),
    "journal": st.builds(
        Journal,
        seq=counts,
        inputs=st.lists(
            st.builds(Input, now_ns=counts, tick=counts)
            | st.builds(Input, now_ns=counts, manner=st.lists(words, max_size=3).map(tuple))
            | st.builds(Input, now_ns=counts, refused=words, id=counts)
            | st.builds(
                Input, now_ns=counts, found=st.builds(Found, slots=words, why=words, model_answered=st.booleans())
            ),
            max_size=4,
        ).map(tuple),
        **header,
    ),
}
CASES = st.sampled_from(TOPICS).flatmap(lambda topic: st.tuples(st.just(topic), STRATEGIES[topic.name]))


def as_map(message: m.Message) -> dict[str, object]:
    plain: dict[str, object] = msgspec.msgpack.decode(encode(message))
    return plain


@ANY_TOPIC
@CALM
@given(payload=st.binary(max_size=4000))
def test_random_bytes_never_raise_anything_but_a_fault(topic: Topic[m.Message], payload: bytes) -> None:
    try:
        decode(topic, payload)
    except Fault:
        pass


@CALM
@given(case=CASES, data=st.data())
def test_a_damaged_message_never_raises_anything_but_a_fault(
    case: tuple[Topic[m.Message], m.Message], data: st.DataObject
) -> None:
    topic, message = case
    payload = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    try:
        decode(topic, bytes(payload[: data.draw(st.integers(0, len(payload)))]))
    except Fault:
        pass


@CALM
@given(case=CASES)
def test_every_message_comes_back_as_it_went_and_is_small(case: tuple[Topic[m.Message], m.Message]) -> None:
    topic, message = case
    payload = encode(message)
    assert len(payload) <= topic.max_bytes
    assert decode(topic, payload) == message


def floats_in(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where in a map the floating-point numbers are."""
    if isinstance(value, float):
        return [path]
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [found for key, item in inner for found in floats_in(item, (*path, key))]


@CALM
@given(case=CASES, data=st.data(), odd=st.sampled_from([math.nan, math.inf, -math.inf]))
def test_no_number_that_is_not_finite_is_read_wherever_it_stands(
    case: tuple[Topic[m.Message], m.Message], data: st.DataObject, odd: float
) -> None:
    topic, message = case
    fields = as_map(message)
    places = [place for place in floats_in(fields) if place != ("goal_x_m",)]
    assume(places)
    *path, last = data.draw(st.sampled_from(places))
    inside: Any = fields
    for key in path:
        inside = inside[key]
    inside[last] = odd
    with pytest.raises(Fault):
        decode(topic, msgspec.msgpack.encode(fields))


@pytest.mark.parametrize(
    "changes",
    [
        {"target_speed_mps": -1.0},
        {"target_speed_mps": 1e9},
        {"headway_s": -0.1},
        {"headway_s": 61.0},
        {"target_lane": -1},
        {"target_lane": 99},
        {"ttl_s": 0.0},
        {"ttl_s": -5.0},
    ],
)
def test_a_directive_out_of_bounds_is_not_read(changes: dict[str, Any]) -> None:
    directive = m.Directive(epoch=1, stamp_ns=0, id=1, command_id=1, scene_tick=0, **changes)
    with pytest.raises(Fault, match=next(iter(changes))):
        decode(DIRECTIVE, encode(directive))


@pytest.mark.parametrize(
    "changes", [{"meta_action": 6}, {"meta_action": -1}, {"style": 3}, {"turn_signal": 2}, {"speed_cap_mps": -1.0}]
)
def test_an_action_out_of_bounds_is_not_read(changes: dict[str, Any]) -> None:
    fields = {"answers_tick": 0, "meta_action": 1, "source": "policy", **changes}
    with pytest.raises(Fault, match=next(iter(changes))):
        decode(ACTION, encode(m.Action(epoch=1, stamp_ns=0, **fields)))


def test_a_message_that_is_too_large_is_not_sent() -> None:
    with pytest.raises(Fault, match="exceeds 3072"):
        encode(m.Command(epoch=0, stamp_ns=0, id=1, text="x" * 10_000))


def test_a_payload_that_is_too_large_is_not_read() -> None:
    with pytest.raises(Fault, match="exceed"):
        decode(OBSERVATION, b"\x80" * (MAX_MESSAGE_BYTES + 1))


@CALM
@given(case=CASES)
def test_a_newer_minor_is_read_and_its_unknown_fields_are_ignored(case: tuple[Topic[m.Message], m.Message]) -> None:
    topic, message = case
    newer = {**as_map(message), "schema": "3.9", "from_the_future": 1}
    assert decode(topic, msgspec.msgpack.encode(newer)) == msgspec.structs.replace(message, schema="3.9")


@ANY_TOPIC
@CALM
@given(data=st.data())
def test_another_major_is_refused_naming_both(topic: Topic[m.Message], data: st.DataObject) -> None:
    message = data.draw(STRATEGIES[topic.name])
    with pytest.raises(Fault, match=rf"4\.0.*{m.SCHEMA_VERSION}"):
        decode(topic, msgspec.msgpack.encode({**as_map(message), "schema": "4.0"}))


def test_a_reason_and_a_kind_of_a_newer_minor_are_kept_as_they_came() -> None:
    event = m.Event(epoch=1, stamp_ns=1, kind=m.EventKind.DELAYED, node="fast", tick=1, reason=m.Reason.LEAD)
    newer = {**as_map(event), "schema": "3.9", "kind": "postponed", "reason": "fog ahead"}
    read = decode(EVENT, msgspec.msgpack.encode(newer))
    assert (read.kind, read.reason) == ("postponed", "fog ahead")
    assert (read.kind in list(m.EventKind), read.reason in list(m.Reason)) == (False, False)
    assert decode(EVENT, encode(read)) == read


def test_a_reason_that_is_no_text_is_refused() -> None:
    event = m.Event(epoch=1, stamp_ns=1, kind=m.EventKind.DELAYED, node="fast", tick=1)
    with pytest.raises(Fault, match="reason"):
        decode(EVENT, msgspec.msgpack.encode({**as_map(event), "reason": 4}))


RECORDED = json.loads(Path(__file__).with_name("recorded.json").read_text("utf-8"))
"""By version and topic: a message's bytes, in base64, as that version has sent it."""


@ANY_TOPIC
def test_bytes_recorded_from_every_version_of_this_major_mean_what_they_meant(topic: Topic[m.Message]) -> None:
    for version, recorded in RECORDED.items():
        if topic.name not in recorded:  # it came with a later version
            continue
        payload = base64.b64decode(recorded[topic.name])
        if version.partition(".")[0] == m.SCHEMA_VERSION.partition(".")[0]:
            message = decode(topic, payload)
            plain = msgspec.msgpack.decode(payload)
            assert {name: as_map(message)[name] for name in plain} == plain
        else:
            with pytest.raises(Fault, match=rf"schema {version[0]}\.\d is not readable"):
                decode(topic, payload)


def test_what_this_version_sends_is_recorded() -> None:
    assert m.SCHEMA_VERSION in RECORDED, "add its messages that are new or have new fields"


def test_every_field_of_what_the_slow_node_took_into_account_is_recorded() -> None:
    payloads = [base64.b64decode(recorded["journal"]) for recorded in RECORDED.values() if "journal" in recorded]
    inputs = [one for payload in payloads for one in msgspec.msgpack.decode(payload)["inputs"]]
    assert {name for one in inputs for name in one} >= set(Input.__struct_fields__)
    assert {name for one in inputs for name in one.get("found", ())} >= set(Found.__struct_fields__)


@CALM
@given(place=st.integers(0, 3 * WIDTH - 1), bad=st.sampled_from([math.nan, math.inf, -math.inf]))
def test_rows_that_are_not_finite_are_refused(place: int, bad: float) -> None:
    rows = np.zeros(3 * WIDTH, np.float32)
    rows[place] = bad
    with pytest.raises(Fault, match="non-finite"):
        decode(OBSERVATION, encode(observation(rows=rows.tobytes())))


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"rows": b""}, "rows"),
        ({"rows": b"\0" * 35}, "rows"),
        ({"lanes": ()}, "lanes"),
        ({"target_lane": 2}, "target_lane"),
        ({"target_lane": -1}, "target_lane"),
        ({"target_speed_mps": math.nan}, "non-finite"),
        ({"layout": "rows/2"}, "layout"),
    ],
)
def test_an_observation_that_makes_no_sense_is_refused(changes: dict[str, Any], why: str) -> None:
    with pytest.raises(Fault, match=why):
        decode(OBSERVATION, encode(observation(**changes)))


def test_rows_come_back_as_a_matrix() -> None:
    rows = rows_of(decode(OBSERVATION, encode(observation(4))))
    assert rows.shape == (4, WIDTH)
    assert rows[1, 0] == WIDTH


@CALM
@given(payload=st.binary(max_size=600) | st.text(max_size=600).map(str.encode))
def test_a_command_is_clean_text_or_a_fault(payload: bytes) -> None:
    try:
        command = decode_command(payload, fallback_id=7, epoch=0, now_ns=0)
    except Fault:
        return
    assert command.text == " ".join(command.text.split()) != ""
    assert len(command.text) <= MAX_COMMAND_CHARS


def test_plain_text_gets_the_fallback_id_and_a_struct_keeps_its_own() -> None:
    plain = decode_command(b"  faster,\n please ", fallback_id=7, epoch=3, now_ns=9)
    assert (plain.id, plain.epoch, plain.text) == (7, 3, "faster, please")
    struct = encode(m.Command(epoch=0, stamp_ns=0, id=42, text="faster"))
    assert decode_command(struct, fallback_id=7, epoch=3, now_ns=9).id == 42


@pytest.mark.parametrize(
    ("payload", "why"),
    [
        (b"", "empty"),
        (b"  \n", "empty"),
        (b"x" * 10_000, "10000 characters"),
        (b"\xff\xfe", "UTF-8"),
        (b"\x81", "UTF-8"),
        (b"a\0b", "control"),
    ],
)
def test_a_bad_command_is_refused_with_its_reason(payload: bytes, why: str) -> None:
    with pytest.raises(Fault, match=why):
        decode_command(payload, fallback_id=1, epoch=0, now_ns=0)
