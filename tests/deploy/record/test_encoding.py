"""What is recorded reads back bit for bit, and a viewer understands its schema."""

from __future__ import annotations

import json
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deploy.record.encoding import from_json, json_schema, to_json
from schemas.wire import messages as m
from schemas.wire.topics import TOPICS

ANY_TOPIC = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
CALM = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
finite = st.floats(allow_nan=False, allow_infinity=False, width=32)


def values(kind: msgspec.inspect.Type) -> st.SearchStrategy[Any]:
    """Anything that a field of this type can hold."""
    match kind:
        case msgspec.inspect.IntType():
            return st.integers(-(2**62) if kind.ge is None else kind.ge, 2**62 if kind.le is None else kind.le)
        case msgspec.inspect.FloatType():
            return st.floats(kind.ge, kind.le)
        case msgspec.inspect.StrType():
            return st.text(max_size=30)
        case msgspec.inspect.BoolType():
            return st.booleans()
        case msgspec.inspect.LiteralType():
            return st.sampled_from(kind.values)
        case msgspec.inspect.EnumType():
            return st.sampled_from(list(kind.cls))
        case msgspec.inspect.NoneType():
            return st.none()
        case msgspec.inspect.UnionType():
            return st.one_of(*map(values, kind.types))
        case msgspec.inspect.VarTupleType():
            return st.lists(values(kind.item_type), max_size=3).map(tuple)
        case msgspec.inspect.DictType():
            return st.dictionaries(values(kind.key_type), values(kind.value_type), max_size=3)
        case msgspec.inspect.BytesType():  # the rows of an observation: whole ones, of numbers
            row = st.lists(finite, min_size=len(m.ROW_COLUMNS), max_size=len(m.ROW_COLUMNS))
            return st.lists(row, min_size=1, max_size=4).map(lambda rows: np.array(rows, "<f4").tobytes())
        case msgspec.inspect.StructType():
            return st.builds(kind.cls, **{field.name: values(field.type) for field in kind.fields})
    raise TypeError(kind)


def plain_json(data: bytes) -> dict[str, Any]:
    """The object, if it has neither Infinity nor NaN in it, which are no JSON."""

    def refuse(word: str) -> None:
        raise ValueError(word)

    fields: dict[str, Any] = json.loads(data, parse_constant=refuse)
    return fields


def exactly(message: m.Message) -> str:
    """Every number by its shortest exact name, the keys of metrics in order."""
    return json.dumps(msgspec.to_builtins(message), sort_keys=True)


@ANY_TOPIC
@given(data=st.data())
@CALM
def test_every_message_comes_back_bit_for_bit(topic, data):
    message = data.draw(values(msgspec.inspect.type_info(topic.type)))
    recorded = to_json(message)
    assert plain_json(recorded)
    assert exactly(from_json(topic.type, recorded)) == exactly(message)


def test_infinity_is_left_out_and_named():
    status = m.Status(epoch=0, stamp_ns=0, node="sim", pid=1, seq=1, state="ready", metrics={"a/b": math.inf, "c": 1.5})
    fields = json.loads(to_json(status))
    assert (fields["metrics"], fields["nonfinite"]) == ({"c": 1.5}, {"/metrics/a~1b": "Infinity"})


@ANY_TOPIC
def test_a_schema_is_one_that_viewers_read(topic):
    """Foxglove and Lichtblick know neither references nor fields of several types nor arrays of arrays."""

    def check(part: dict[str, Any], inside: str = "") -> None:
        assert isinstance(part["type"], str)
        assert not part.keys() & {"$ref", "anyOf", "oneOf", "default"}
        assert not (inside == "array" and part["type"] == "array")
        for inner in part.get("properties", {}).values():
            check(inner, "object")
        if part["type"] == "array":
            check(part["items"], "array")

    check(plain_json(json_schema(topic.type)))
