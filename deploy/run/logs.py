"""The logs in a run's folder: a line of JSON each, and never more than a run of any length can afford."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path

from slow_node.config import THOUGHTS

LOG_BYTES = 5_000_000
"""Of each log; as much of what came before is kept beside it, in `NAME.old.jsonl`."""


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
