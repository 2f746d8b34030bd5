"""Scheduling of the latency-critical processes. It must be claimed before zenoh starts its threads: they inherit it."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Literal

Mode = Literal["auto", "fifo", "user", "off"]
MODES: tuple[Mode, ...] = ("auto", "fifo", "user", "off")
PRIORITY = 50
"""Of SCHED_FIFO: above every normal process, below the kernel's own threads. Nodes sleep most of the time, and Linux
keeps 5 % of each core for the others whatever they do."""
FIFO = f"SCHED_FIFO {PRIORITY}"
NICE = -15


def resolve(mode: Mode) -> Mode:
    """What a mode comes to here: SCHED_FIFO where it is permitted, else what a plain user may do, else nothing."""
    if mode == "off" or sys.platform != "linux":
        return "off"
    return "user" if mode == "user" or not _fifo_permitted() else "fifo"


def _fifo_permitted() -> bool:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        os.sched_setscheduler(0, *before)
    except OSError:
        return False
    return True


def claim(mode: Mode) -> str:
    """Take the scheduling that a mode comes to here, for this thread and those it starts, and say which. Never fails.

    A plain user may raise a priority as far as RLIMIT_NICE goes, which is often nowhere.
    """
    resolved = resolve(mode)
    try:
        if resolved == "fifo":
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
            return FIFO
        if resolved == "user":
            os.setpriority(os.PRIO_PROCESS, 0, NICE)
            _weigh_session(NICE)
            return f"nice {NICE}"
    except OSError as error:
        return f"normal priority ({resolved}: {error.strerror})"
    return "off"


def may_poll(scheduling: str) -> bool:
    """Whether a thread may wait awake, with what `claim` said: zenoh's threads need its priority and a second core."""
    return scheduling == FIFO and len(os.sched_getaffinity(0)) > 1


def _weigh_session(nice: int) -> None:
    """Linux with autogroups weighs whole sessions against each other, whatever the priorities within them."""
    group = Path("/proc/self/autogroup")
    if group.exists():
        group.write_text(str(nice), encoding="ascii")
