"""What a benchmark says while it runs, and what ends a part of it."""

from __future__ import annotations

import sys


class MeasurementError(Exception):
    """What is measured, or the load beside it, did not come up or died; `str()` says what and why in one line.

    It ends neither the benchmark nor what else is measured.
    """


def say(line: str) -> None:
    """Progress, on stderr."""
    print(line, file=sys.stderr, flush=True)
