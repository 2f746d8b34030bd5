"""Files that come from outside: read whole, as far as they are of a size that can be meant."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from schemas.runtime.errors import ConfigError
from schemas.wire.text import plain

SETTING_BYTES = 50_000
"""Of a scenario file at most: its text travels in a node's one argument."""


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """All of a plain file. Raises `ConfigError`, one line, where there is none, where it cannot be read, for a folder,
    a pipe or a device, and for more than `most_bytes`."""
    name = plain(str(path), 300)
    try:
        mode = path.stat().st_mode
        if not stat.S_ISREG(mode):
            raise ConfigError(f"{name} is {'a folder' if stat.S_ISDIR(mode) else 'no plain file'}: give a file")
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except FileNotFoundError:
        raise ConfigError(f"there is no file {name}: check the path") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ConfigError(f"cannot read {name}: {plain(reason, 100)}") from None
    if len(data) > most_bytes:
        raise ConfigError(f"{name} is larger than {most_bytes:,} bytes, the most that is read: give a smaller file")
    return data


def read_text_bounded(path: Path, most_bytes: int = SETTING_BYTES) -> str:
    """The same as text. Raises `ConfigError` for what is not UTF-8, too."""
    try:
        return read_bounded(path, most_bytes).decode()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{plain(str(path), 300)} is not UTF-8 (byte {error.start}): save it as UTF-8") from None


def lines_bounded(file: IO[bytes], most_bytes: int) -> Iterator[bytes | None]:
    """The lines of an open file without their ends, one at a time; None for each that is longer than `most_bytes`, of
    which no more is ever in memory."""
    while line := file.readline(most_bytes + 1):
        if len(line) <= most_bytes or line.endswith(b"\n"):
            yield line.rstrip(b"\r\n")
            continue
        while (rest := file.readline(most_bytes)) and not rest.endswith(b"\n"):
            pass
        yield None
