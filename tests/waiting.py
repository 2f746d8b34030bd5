"""Waiting for an event, for tests that run processes and threads."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
PATIENCE_S = 60.0
"""Far longer than anything takes: it only ends a test that would hang, and decides nothing."""


def until(condition: Callable[[], T], otherwise: str = "it did not happen") -> T:
    """What `condition()` returns once it is true; an assertion error that says `otherwise` if it never is."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < give_up_s, otherwise
        time.sleep(0.005)
    return found
