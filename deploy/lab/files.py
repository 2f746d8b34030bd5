"""Files of the lab: a folder's by value, as a task that ran elsewhere hands them over, one that grows by rows, and a
table."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from schemas.runtime.process import ConfigError

Row = TypeVar("Row")


def brought(folder: Path) -> dict[str, bytes]:
    """All files below a folder, by their names in it."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def put(files: Mapping[str, bytes], folder: Path, last: str) -> None:
    """Write them, each at once, and the file `last` after all others: where it is, they are."""
    for name in sorted(files, key=lambda name: name == last):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        new = path.with_name(f"{path.name}.new")
        new.write_bytes(files[name])
        os.replace(new, path)


def whole_lines(path: Path, begins: bytes, read: Callable[[bytes], Row]) -> list[Row]:
    """What `read` makes of each line of a file to which rows are appended; nothing where there is no file yet.

    A row at its end that was interrupted while it was written is cut off: the next one begins a line. begins: how every
    row does. Raises `ConfigError` for a file that cannot be read, or holds something else; it stays as it is.
    """
    try:
        content = path.read_bytes() if path.exists() else b""
        *lines, rest = content.split(b"\n")
        if not (rest.startswith(begins) or begins.startswith(rest)):
            raise ValueError(rest)
        rows = [read(line) for line in lines]
        if rest:
            os.truncate(path, len(content) - len(rest))
    except (OSError, ValueError, TypeError, LookupError, AttributeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it holds something else"
        raise ConfigError(f"{path} cannot be gone on with: {why}; move it away, or name another file") from None
    return rows


def write_table(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """A CSV file, numbers with four digits; `x_ci95` becomes `x_low` and `x_high`, any other list one cell."""
    flat = [dict(cell for column, value in row.items() for cell in _cells(column, value)) for row in rows]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list({column: None for row in flat for column in row}))
        writer.writeheader()
        writer.writerows(flat)


def _cells(column: str, value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, list | tuple) and column.endswith("_ci95"):
        name = column.removesuffix("_ci95")
        return [(f"{name}_{end}", f"{bound:.4g}") for end, bound in zip(("low", "high"), value, strict=True)]
    if isinstance(value, list | tuple):
        return [(column, " ".join(map(str, value)))]
    return [(column, f"{value:.4g}" if isinstance(value, float) else value)]
