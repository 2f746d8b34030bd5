"""A folder's files by value: how a task that ran elsewhere hands them over."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path


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
