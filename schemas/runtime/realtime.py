"""Scheduling of the latency-critical processes. It must be claimed before zenoh starts its threads: they inherit it.

Linux keeps a core, a priority and a class for each thread; only the weight of a session is of all its processes.
"""

from __future__ import annotations

import os
import resource
import sys
import threading
import time
from pathlib import Path
from typing import Literal

Mode = Literal["auto", "fifo", "user", "off"]
MODES: tuple[Mode, ...] = ("auto", "fifo", "user", "off")
PRIORITY = 50
"""Of SCHED_FIFO: above every normal process, below the kernel's own threads. Nodes sleep most of the time, and Linux
keeps 5 % of each core for the others whatever they do."""
FIFO = f"SCHED_FIFO {PRIORITY}"
NICE = -15
"""What a plain user's mode asks for, and gets as far as RLIMIT_NICE goes, which is often nowhere."""


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
    """Take the scheduling that a mode comes to here, for this thread and those it starts. Never fails.

    Returns what was really obtained: "SCHED_FIFO 50", "core 1, nice 0" or "off".
    """
    said = _take(mode)
    if resolve(mode) == "user" and (nice := os.getpriority(os.PRIO_PROCESS, 0)) < 0:
        weigh_session(nice)
    return said


def trial(mode: Mode) -> str:
    """What `claim` obtains here, found out on a thread that ends at once: this process stays as it is."""
    said: list[str] = []
    thread = threading.Thread(target=lambda: said.append(_take(mode)))
    thread.start()
    thread.join()
    return said[0]


def _take(mode: Mode) -> str:
    """For the calling thread alone."""
    resolved = resolve(mode)
    if resolved == "off":
        return "off"
    if resolved == "fifo":
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        return FIFO
    said = f"{_pin()}nice {_raise_priority()}"
    return f"{said} (SCHED_FIFO is not permitted)" if mode == "fifo" else said


def shared_core() -> int:
    """The core for both latency-critical processes: of those allowed the fastest, and of these the last.

    They work in turns. On one core neither wakes another one up, nor is it moved to where something else computes.
    """
    return max(os.sched_getaffinity(0), key=lambda core: (_top_khz(core), core))


def _top_khz(core: int) -> int:
    """The highest clock rate of a core; 0 where the kernel does not tell (most virtual machines)."""
    try:
        return int(Path(f"/sys/devices/system/cpu/cpu{core}/cpufreq/cpuinfo_max_freq").read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 0


def _pin() -> str:
    core = shared_core()
    try:
        os.sched_setaffinity(0, {core})
    except OSError:
        return ""
    return f"core {core}, "


def _raise_priority() -> int:
    """As far as it is permitted; returns the niceness that it then is."""
    limit = 20 - resource.getrlimit(resource.RLIMIT_NICE)[0]
    for nice in (NICE, max(NICE, limit)):  # the first one takes CAP_SYS_NICE, which knows no limit
        if nice < os.getpriority(os.PRIO_PROCESS, 0):
            try:
                os.setpriority(os.PRIO_PROCESS, 0, nice)
            except OSError:
                pass
    return os.getpriority(os.PRIO_PROCESS, 0)


def may_poll(scheduling: str) -> bool:
    """Whether a thread may wait awake, with what `claim` said: zenoh's threads need its priority and a second core."""
    return scheduling == FIFO and len(os.sched_getaffinity(0)) > 1


def weigh_session(nice: int) -> None:
    """Weigh this session against the others as `nice` would a process. Never fails.

    Linux with autogroups shares each core between sessions first, whatever the priorities and classes within them but
    for real-time ones. Everybody may lower a session's weight.
    """
    try:
        with open("/proc/self/autogroup", "wb", buffering=0) as group:
            for _ in range(10):
                if group.write(str(nice).encode()) is not None:
                    return
                time.sleep(0.1)  # EAGAIN: the kernel allows one such change in 0.1 s, whoever asks for it
    except OSError:  # no autogroups, or not permitted
        pass


def yield_to_others(nice: int = 19) -> str:
    """Run only when nobody else wants the core, this thread and those it starts. Never fails; returns what it got.

    With autogroups SCHED_IDLE counts only within a session, so that the session's weight goes down as well, to that of
    `nice`: of one that is this process's own, not of the shell that somebody started it from.
    """
    if sys.platform != "linux":
        return "off"
    said = "SCHED_IDLE"
    try:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    except OSError:
        said = "off (SCHED_IDLE is not permitted)"
    if os.getsid(0) == os.getpid():
        weigh_session(nice)
    return said
