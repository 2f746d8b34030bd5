"""A running system, for tests."""

from __future__ import annotations

from pathlib import Path

import psutil

ROOT = Path(__file__).parents[1]
HURRY = "I'm in a hurry to get to work, I want to drive faster"


def child_of(parent: int, module: str) -> int:
    """The pid of a running child process `python -m module`; 0 where there is none."""
    for child in psutil.Process(parent).children():
        try:
            words = child.cmdline()
        except psutil.Error:
            continue
        if "-m" in words and words[words.index("-m") + 1] == module:
            return child.pid
    return 0
