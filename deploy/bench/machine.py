"""The machine that is measured on: what the figures depend on, and what a process or its cores use."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import psutil

from schemas.runtime.process import revision
from schemas.runtime.realtime import Mode, trial


def host(realtime: Mode) -> dict[str, object]:
    """What the figures depend on."""
    versions: dict[str, str | None] = {"python": platform.python_version()}
    for name in ("fastslow", "eclipse-zenoh", "numpy", "msgspec", "pyzmq", "dora-rs"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    return {
        "revision": revision(),
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "kernel": f"{platform.system()} {platform.release()}",
        "load_average": [round(x, 2) for x in os.getloadavg()],
        "realtime": trial(realtime),
        "versions": versions,
    }


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def rss_mb(pid: int | None) -> float | None:
    """Resident memory of a process in MB; None if it has ended."""
    try:
        return round(psutil.Process(pid).memory_info().rss * 1e-6, 1) if pid is not None else None
    except psutil.Error:
        return None


def idle_s() -> float:
    """What all cores together have idled since the machine's start, waiting for a disk included."""
    times = psutil.cpu_times()
    return float(times.idle + getattr(times, "iowait", 0.0))
