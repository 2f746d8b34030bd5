"""What a long run takes of the machine: memory and descriptors of each process, disk, and what it leaves behind."""

from __future__ import annotations

import statistics
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

MB = 1e6
WARM_UP = 0.2
"""So much of a run is not measured: caches fill."""
YOUNG_S = 20.0
"""A process younger than this is still loading."""
SHARED = "/dev/shm/"


@dataclass
class Course:
    """What one kind of process, or one folder, has taken in the course of the run."""

    at_s: list[float] = field(default_factory=list)
    megabytes: list[float] = field(default_factory=list)
    descriptors: list[int] = field(default_factory=list)

    def told(self) -> dict[str, float]:
        """Slope by least squares, last value, and how many descriptors more than at first."""
        told = {"mb_per_min": round(slope(self.at_s, self.megabytes), 3), "mb": round(self.megabytes[-1], 1)}
        if self.descriptors:
            few = max(1, len(self.descriptors) // 10)
            more = statistics.median(self.descriptors[-few:]) - statistics.median(self.descriptors[:few])
            told |= {"descriptors": self.descriptors[-1], "descriptors_more": more}
        return told


def slope(at_s: Sequence[float], values: Sequence[float]) -> float:
    """Of values over time, by least squares [1/min]; 0 of fewer than three."""
    return float(np.polyfit(np.array(at_s) / 60.0, values, 1)[0]) if len(at_s) > 2 else 0.0


def name_of(process: psutil.Process) -> str:
    """The module that a Python process runs, else its program."""
    words = process.cmdline()
    if "-m" in words[:-1]:
        return words[words.index("-m") + 1]
    return "the supervisor" if "run_system" in " ".join(words) else Path(words[0] if words else "?").name


def shared_by(process: psutil.Process) -> set[str]:
    """The files of shared memory that a process has mapped; others on this machine have some, too."""
    try:
        return {mapped.path for mapped in process.memory_maps() if mapped.path.startswith(SHARED)}
    except (psutil.Error, OSError):  # it has just been killed
        return set()


def bytes_in(folder: Path) -> dict[str, int]:
    """Of every file below a folder."""
    sizes = {}
    for path in folder.rglob("*"):
        try:
            if path.is_file():
                sizes[str(path.relative_to(folder))] = path.stat().st_size
        except OSError:  # gone meanwhile
            continue
    return sizes


class Meter:
    """Looks at a run again and again. `folder`: where it writes, with its `tmp` in it."""

    def __init__(self, pid: int, folder: Path, seconds: float) -> None:
        self._root, self._folder, self._began_s, self._seconds = psutil.Process(pid), folder, time.monotonic(), seconds
        self._processes: dict[str, Course] = defaultdict(Course)
        self.disk = Course()
        self.largest: dict[str, int] = {}
        self._shared: set[str] = set()
        self.known: list[psutil.Process] = []

    def family(self) -> Iterator[psutil.Process]:
        yield self._root
        yield from self._root.children(recursive=True)

    def look(self) -> None:
        """One sample, unless it is too early."""
        at_s = time.monotonic() - self._began_s
        self.known = list(self.family())
        for process in self.known:
            self._shared |= shared_by(process)
        if at_s < WARM_UP * self._seconds:
            return
        for process in self.known:
            try:
                if time.time() - process.create_time() < YOUNG_S:
                    continue
                course = self._processes[name_of(process)]
                with process.oneshot():
                    megabytes, descriptors = process.memory_info().rss / MB, process.num_fds()
            except psutil.Error:  # it has just been killed
                continue
            course.at_s.append(at_s)
            course.megabytes.append(megabytes)
            course.descriptors.append(descriptors)
        sizes = bytes_in(self._folder)
        self.disk.at_s.append(at_s)
        self.disk.megabytes.append(sum(sizes.values()) / MB)
        for name, size in sizes.items():
            kind = Path(name).name
            self.largest[kind] = max(size, self.largest.get(kind, 0))

    def told(self) -> dict[str, dict[str, float]]:
        """By process, whatever has been seen of it for long enough."""
        return {name: course.told() for name, course in sorted(self._processes.items()) if course.at_s}

    def left(self, wait_s: float = 3.0) -> dict[str, int]:
        """After the end: processes, entries of the temporary folder and of shared memory that are still there."""
        until_s = time.monotonic() + wait_s
        while time.monotonic() < until_s:
            alive = [p for p in self.known if p.is_running() and p.status() != psutil.STATUS_ZOMBIE]
            temporary = list((self._folder / "tmp").iterdir())
            if not alive and not temporary:
                break
            time.sleep(0.05)
        shared = [path for path in self._shared if Path(path).exists()]
        return {"processes": len(alive), "temporary": len(temporary), "shared_memory": len(shared)}
