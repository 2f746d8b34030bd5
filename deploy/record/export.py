"""A recording as tables: CSV, Parquet, or a Minari data set.

One table for each topic, and two more from the observations: `vehicles`, a row per car and tick, and `lanes`, a row per
lane wherever the road changes. What is nested otherwise is JSON text. A first column `time_ns` says when each arrived.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TextIO, get_args, get_origin, get_type_hints

import msgspec

from deploy.record.reader import Recording
from schemas.driving.road import ID, LANE
from schemas.runtime.process import ConfigError
from schemas.wire.codec import rows_of
from schemas.wire.messages import ROW_COLUMNS, Lane, Message, Observation
from schemas.wire.topics import TOPICS

Kind = Literal["int", "float", "bool", "text"]
Row = dict[str, Any]
VEHICLES, LANES = "vehicles", "lanes"
BATCH = 20_000
"""Rows that are held in memory at once."""


def tables() -> dict[str, dict[str, Kind]]:
    """Every table with the kinds of its columns."""
    place: dict[str, Kind] = {"time_ns": "int", "epoch": "int", "tick": "int"}
    whole: tuple[Kind, Kind] = ("int", "float")
    vehicle: dict[str, Kind] = {name: whole[k not in (ID, LANE)] for k, name in enumerate(ROW_COLUMNS)}
    return {
        **{topic.name: {"time_ns": "int", **_columns(topic.type)} for topic in TOPICS},
        VEHICLES: place | vehicle,
        LANES: place | {"index": "int"} | _columns(Lane),
    }


def _columns(struct: type[msgspec.Struct]) -> dict[str, Kind]:
    hints = get_type_hints(struct)
    return {
        field.name: _kind(hints[field.name])
        for field in msgspec.structs.fields(struct)
        if field.name not in ("rows", "lanes")
    }


def _kind(hint: Any) -> Kind:
    if get_origin(hint) in (UnionType, Literal):
        inner = [a if get_origin(hint) is UnionType else type(a) for a in get_args(hint) if a is not type(None)]
        return _kind(inner[0])
    if hint in (int, float, bool):
        return {int: "int", float: "float", bool: "bool"}[hint]  # type: ignore[return-value]
    return "text"


def rows(recording: Recording) -> Iterator[tuple[str, Row]]:
    """(table, row) for all that was recorded, in the order of its arrival."""
    road: tuple[Lane, ...] = ()
    for time_ns, topic, message in recording.messages():
        yield topic, {"time_ns": time_ns, **_row(message)}
        if not isinstance(message, Observation):
            continue
        place = {"time_ns": time_ns, "epoch": message.epoch, "tick": message.tick}
        for row in rows_of(message).tolist():
            vehicle = dict(zip(ROW_COLUMNS, row, strict=True))
            yield VEHICLES, {**place, **vehicle, "id": int(row[ID]), "lane": int(row[LANE])}
        if message.lanes != road:
            road = message.lanes
            for index, lane in enumerate(road):
                yield LANES, {**place, "index": index, **_row(lane)}


def _row(struct: Message | Lane) -> Row:
    fields = {name: getattr(struct, name) for name in struct.__struct_fields__ if name not in ("rows", "lanes")}
    return {
        name: value if value is None or isinstance(value, int | float | str) else msgspec.json.encode(value).decode()
        for name, value in fields.items()
    }


def to_csv(recording: Recording, folder: Path) -> dict[str, int]:
    """Write a CSV file for each table into `folder`, made if need be; returns how many rows each has."""
    folder.mkdir(parents=True, exist_ok=True)
    counts = dict.fromkeys(tables(), 0)
    with ExitStack() as stack:
        writers = {}
        for name, columns in tables().items():
            file: TextIO = stack.enter_context((folder / f"{name}.csv").open("w", newline="", encoding="utf-8"))
            writers[name] = csv.DictWriter(file, list(columns))
            writers[name].writeheader()
        for table, row in rows(recording):
            writers[table].writerow(row)
            counts[table] += 1
    return counts


def to_parquet(recording: Recording, folder: Path) -> dict[str, int]:
    """Write a Parquet file for each table into `folder`, made if need be; returns how many rows each has."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise missing("pyarrow") from None
    kinds = {"int": pyarrow.int64(), "float": pyarrow.float64(), "bool": pyarrow.bool_(), "text": pyarrow.string()}
    folder.mkdir(parents=True, exist_ok=True)
    counts = dict.fromkeys(tables(), 0)
    with ExitStack() as stack:
        writers, batches = {}, {}
        for name, columns in tables().items():
            schema = pyarrow.schema([(column, kinds[kind]) for column, kind in columns.items()])
            writers[name] = stack.enter_context(parquet.ParquetWriter(folder / f"{name}.parquet", schema))
            batches[name] = list[Row]()

        def flush(table: str) -> None:
            writers[table].write_table(pyarrow.Table.from_pylist(batches[table], schema=writers[table].schema))
            counts[table] += len(batches[table])
            batches[table].clear()

        for table, row in rows(recording):
            batches[table].append(row)
            if len(batches[table]) >= BATCH:
                flush(table)
        for table in batches:
            flush(table)
    return counts


def missing(package: str) -> ConfigError:
    """What to say where an optional package is not installed."""
    return ConfigError(f"{package} is missing: pip install 'fastslow[record]'")
