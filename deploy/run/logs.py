"""The logs in the folders of runs: a line of JSON each. No run of any length fills the disk, and no number of runs."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
from contextlib import suppress
from pathlib import Path
from typing import IO

from slow_node.config import THOUGHTS, WISHES

LOG_BYTES = 5_000_000
"""Of each log; as much of what came before is kept beside it, in `NAME.old.jsonl`."""
SUPERVISOR, SUMMARY = "supervisor.jsonl", "summary.json"
_FOLDER = re.compile(r"\d{8}T\d{6}Z-\d+")
"""The name of a run's folder; names are in the order of the runs."""


def rotate(folder: Path, most_bytes: int = LOG_BYTES) -> None:
    """Where a log has become too long, keep it as the old one, in the place of the last, and go on with an empty one.

    The processes hold their logs open to append, so that a log is cut, not moved. What is written while it is copied
    is lost. A full disk changes nothing.
    """
    for log in folder.glob("*.jsonl"):
        if log.name == THOUGHTS or log.name.endswith(".old.jsonl"):
            continue  # thoughts: the slow node looks after them itself
        with suppress(OSError):
            if log.stat().st_size > most_bytes:
                shutil.copyfile(log, log.with_suffix(".old.jsonl"))
                os.truncate(log, 0)


def open_log(folder: Path) -> IO[bytes]:
    """The supervisor's own log, to append to. As long as it is open, `prune` leaves the folder alone."""
    log = open(folder / SUPERVISOR, "ab", buffering=0)  # noqa: SIM115 - as long as the run
    with suppress(OSError):  # a file system without locks
        fcntl.flock(log, fcntl.LOCK_SH | fcntl.LOCK_NB)
    return log


def prune(runs: Path, max_bytes: float) -> list[Path]:
    """Remove the logs and summaries of the oldest runs in `runs` until those of all take at most `max_bytes`.

    Returns their folders, which go as well if nothing else is in them: a recording has a bound of its own. A run that
    is going on is left alone.
    """
    folders = sorted(folder for folder in runs.iterdir() if _FOLDER.fullmatch(folder.name))
    sizes = {folder: sum(path.stat().st_size for path in _logs(folder)) for folder in folders}
    total, removed = sum(sizes.values()), []
    for folder, size in sizes.items():
        if total <= max_bytes:
            break
        with suppress(OSError), (folder / SUPERVISOR).open("rb") as log:
            fcntl.flock(log, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for path in _logs(folder):
                path.unlink()
            total -= size
            removed.append(folder)
            folder.rmdir()
    return removed


def _logs(folder: Path) -> list[Path]:
    """The supervisor's, by which a run is known, comes last."""
    found = [*folder.glob("*.jsonl"), *folder.glob(SUMMARY), *folder.glob(WISHES)]
    return sorted(found, key=lambda path: path.name == SUPERVISOR)
