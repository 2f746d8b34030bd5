"""Messages as JSON and back, bit for bit, with a JSON schema for each type.

Viewers want plain JSON schemas: no references, one type per field, arrays of objects. So an observation's `rows` become
`vehicles`, objects with a name for every number; a field without a value is left out; and what JSON has no number for
(infinity, not-a-number) is left out as well, and named in `nonfinite`, by its place in the message.
"""

from __future__ import annotations

import json
import math
from typing import Any, TypeVar

import msgspec
import numpy as np

from schemas.wire.codec import rows_of
from schemas.wire.messages import ROW_COLUMNS, Message, Observation

M = TypeVar("M", bound=Message)

_VEHICLE = "{" + ",".join(f'"{name}":%.9g' for name in ROW_COLUMNS) + "}"
"""Nine significant digits name every float32 exactly."""
_NO_ROWS = b'"rows":""'
_NUMBERS = {"Infinity": math.inf, "-Infinity": -math.inf, "NaN": math.nan}


def to_json(message: Message) -> bytes:
    """The message as one JSON object. An observation's rows must be finite, as the bus's decoder assures."""
    if isinstance(message, Observation):
        plain = _plain(msgspec.structs.replace(message, rows=b""))
        return plain.replace(_NO_ROWS, b'"vehicles":[' + _vehicles(message) + b"]", 1)
    return _plain(message)


def from_json(kind: type[M], data: bytes) -> M:
    """The message that `to_json` was given. Raises `msgspec.DecodeError` on anything else."""
    if issubclass(kind, Observation) or b'"nonfinite":' in data:
        return _from_plain(kind, msgspec.json.decode(data))
    return msgspec.json.decode(data, type=kind)


def _vehicles(observation: Observation) -> bytes:
    rows = rows_of(observation)
    text = ",".join([_VEHICLE] * len(rows)) % tuple(rows.ravel().tolist())
    if ":-0," in text or ":-0}" in text:  # a reader would take it for an integer, and lose its sign
        text = text.replace(":-0,", ":-0.0,").replace(":-0}", ":-0.0}")
    return text.encode()


def _plain(message: Message) -> bytes:
    encoded = msgspec.json.encode(message)
    if b"null" not in encoded:  # msgspec's word for infinity, too
        return encoded
    fields = msgspec.to_builtins(message)
    nonfinite: dict[str, str] = {}
    _leave_out(fields, "", nonfinite)
    if nonfinite:
        fields["nonfinite"] = nonfinite
    return msgspec.json.encode(fields)


def _leave_out(value: Any, place: str, nonfinite: dict[str, str]) -> None:
    """Remove from `value`, an object or an array, what has no value or no number, and note the latter's place."""
    for key, inner in list(value.items() if isinstance(value, dict) else enumerate(value)):
        at = f"{place}/{str(key).replace('~', '~0').replace('/', '~1')}"
        if isinstance(inner, float) and not math.isfinite(inner):
            nonfinite[at] = "NaN" if math.isnan(inner) else "Infinity" if inner > 0 else "-Infinity"
            inner = None
            if isinstance(value, list):
                value[key] = 0.0  # keeps its neighbours in their places
        if inner is None and isinstance(value, dict):
            del value[key]
        elif isinstance(inner, dict | list | tuple):
            _leave_out(inner, at, nonfinite)


def _from_plain(kind: type[M], fields: dict[str, Any]) -> M:
    for place, number in fields.pop("nonfinite", {}).items():
        *parents, last = (key.replace("~1", "/").replace("~0", "~") for key in place[1:].split("/"))
        inner: Any = fields
        for key in parents:
            inner = inner[int(key)] if isinstance(inner, list) else inner[key]
        inner[int(last) if isinstance(inner, list) else last] = _NUMBERS[number]
    vehicles = fields.pop("vehicles", None)
    if vehicles is not None:
        rows = np.array([[vehicle[name] for name in ROW_COLUMNS] for vehicle in vehicles], "<f4")
        fields["rows"] = rows.tobytes()
    return msgspec.convert(fields, kind, builtin_types=(bytes,))


def json_schema(kind: type[Message]) -> bytes:
    """The JSON schema of `to_json`'s objects, without references."""
    (_, parts) = msgspec.json.schema_components([kind])
    schema: dict[str, Any] = _flat(parts[kind.__name__], parts)
    properties = schema["properties"]
    if "rows" in properties:
        del properties["rows"]
        schema["required"] = [name for name in schema["required"] if name != "rows"] + ["vehicles"]
        vehicle = {"type": "object", "properties": {name: {"type": "number"} for name in ROW_COLUMNS}}
        properties["vehicles"] = {
            "type": "array",
            "description": "The ego first, then by distance.",
            "items": {**vehicle, "required": list(ROW_COLUMNS)},
        }
    properties["nonfinite"] = {
        "type": "object",
        "description": "Numbers that JSON cannot write, by their place in the message.",
        "additionalProperties": {"type": "string"},
    }
    return json.dumps(schema).encode()


def _flat(part: Any, parts: dict[str, Any]) -> Any:
    """Without `$ref`, `anyOf [..., null]`, enumerations of no type, and the defaults, which may be infinite."""
    if isinstance(part, list):
        return [_flat(inner, parts) for inner in part]
    if not isinstance(part, dict):
        return part
    if "$ref" in part:
        return _flat(parts[part["$ref"].rpartition("/")[2]], parts)
    if "anyOf" in part:
        (one,) = (option for option in part["anyOf"] if option.get("type") != "null")
        return _flat(one, parts)
    flat = {key: _flat(inner, parts) for key, inner in part.items() if key != "default"}
    if "enum" in part:
        flat["type"] = "string" if all(isinstance(word, str) for word in part["enum"]) else "integer"
    if "description" in part:
        flat["description"] = " ".join(part["description"].split())
    return flat
