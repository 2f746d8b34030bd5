"""A running system, for tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import psutil

ROOT = Path(__file__).parents[1]
RUN = [sys.executable, "-m", "deploy", "run", "--port", "0", "--json", "--seed", "3"]
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


def start(tmp_path: Path, *more: str, **model_env: str) -> subprocess.Popen[str]:
    """A run in a folder of its own, whose summary comes on stdout. model_env: the variables of its language model."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "FASTSLOW_DATA": str(tmp_path), **model_env}
    return subprocess.Popen(
        [*RUN, *more], cwd=tmp_path, env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
