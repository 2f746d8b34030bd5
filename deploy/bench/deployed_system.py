"""The system as `fastslow run` deploys it, under a benchmark's eyes."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deploy.bench.machine import rss_mb
from deploy.bench.progress import MeasurementError
from deploy.run.launch import temporary_folder
from deploy.run.processes import TCP_HOST, Model, Process, RunOptions, free_port, links_of, process_table
from deploy.run.supervisor import Supervisor
from schemas.runtime.bus import ZenohBus, open_bus
from schemas.runtime.realtime import Mode
from schemas.wire import topics
from schemas.wire.messages import Observation

START_S = 60.0
"""For the whole system to be ready."""


class Deployment:
    """The system as `fastslow run` deploys it, without what `without` names."""

    def __init__(self, folder: Path, realtime: Mode, *without: str, trace: bool, watched: bool = False) -> None:
        """watched: with the recorder, which writes into `folder`, and the cockpit."""
        self._stack = ExitStack()
        self.sockets = self._stack.enter_context(temporary_folder())
        self._port, llm = free_port(), free_port()
        self.model = Model(base_url=f"http://127.0.0.1:{llm}/v1", name="SmolLM2-135M-Instruct", embedded=True, port=llm)
        cockpit_port = free_port() if watched else None
        self.page = f"ws://{TCP_HOST}:{cockpit_port}/live" if watched else ""
        """Where a page of the cockpit connects."""
        self.metrics: dict[str, dict[str, float]] = {}
        """Of each node, its newest."""
        options = RunOptions(
            port=self._port,
            realtime=realtime,
            without=without,
            trace=folder if trace else None,
            cockpit_port=cockpit_port,
        )
        self._notices: list[str] = []
        self.links = links_of(options, self.sockets)
        rows = process_table(options, self.model, self.links, folder if watched else None)
        table = tuple(self._private(process) for process in rows)
        self._supervisor = Supervisor(table, folder, self._notices.append)
        self.bus: ZenohBus
        self.newest: Observation | None = None
        self.action_bytes = 0
        self.lost = self.lost_process = ""
        """Why it is no longer what it should be, and which process died; empty while it runs."""

    def _private(self, process: Process) -> Process:
        """The passenger's own memory is not touched by a benchmark."""
        argv = [*process.argv]
        if process.name == "slow":
            config = json.loads(argv[-1])
            argv[-1] = json.dumps({**config, "memory_path": str(self.sockets / "memory.sqlite")})
        return replace(process, argv=tuple(argv))

    def __enter__(self) -> Deployment:
        with self._stack as stack:
            self.links.write_logins()
            self.bus = stack.enter_context(open_bus(self.links.supervisor()))
            self._status = self.bus.subscribe(topics.STATUS)
            self._observations = self.bus.subscribe(topics.OBSERVATION)
            self._actions = self.bus.subscribe_bytes(topics.ACTION)
            stack.callback(self._supervisor.stop, self._read)
            self._supervisor.start()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def _read(self) -> None:
        for status in self._status.take():
            self._supervisor.beat(status.node, status.pid)
            self.metrics[status.node] = status.metrics
        self.newest = next(iter(self._observations.take()), self.newest)
        for payload in self._actions.take():
            self.action_bytes = len(payload)

    def step(self) -> None:
        """Look after it, once, until it is lost."""
        if self.lost:
            return
        self._read()
        code = self._supervisor.step()
        states, restarts = self._supervisor.states, self._supervisor.restarts
        died = next((name for name in states if restarts[name] or states[name] in ("gave up", "ended")), "")
        if died or code is not None:
            notice = self._notices[0].partition("; restarting")[0] if self._notices else f"{died} ended"
            words = self._supervisor.last_words(died)
            self.lost_process, self.lost = died, notice if words in notice else f"{notice}: {words}"

    def until(self, met: Callable[[], bool], what: str) -> None:
        """Look after it until this is met.

        Raises `MeasurementError` if one of its processes dies, or it takes too long.
        """
        deadline = time.monotonic() + START_S
        while not met():
            self.step()
            if self.lost:
                raise MeasurementError(self.lost)
            if time.monotonic() > deadline:
                raise MeasurementError(f"{what} took longer than {START_S:g} s: {self._supervisor.states}")
            time.sleep(0.002)

    def ready(self) -> None:
        """Look after it until all are ready. Raises `MeasurementError`."""
        self.until(lambda: set(self._supervisor.states.values()) == {"ready"}, "the start")

    def watch(self, seconds: float) -> None:
        """Look after it for so long."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.step()
            time.sleep(0.02)

    def rss_mb(self, name: str) -> float | None:
        """Resident memory of a node (Linux)."""
        return rss_mb(self._supervisor.pid(name))

    def scheduling(self, name: str) -> str:
        """Scheduling class of a node's main thread (Linux)."""
        pid = self._supervisor.pid(name)
        if pid is None:
            return "unknown"
        try:
            if os.sched_getscheduler(pid) == os.SCHED_FIFO:
                return f"SCHED_FIFO {os.sched_getparam(pid).sched_priority}"
            cores = os.sched_getaffinity(pid)
            return f"{f'core {min(cores)}, ' if len(cores) == 1 else ''}nice {os.getpriority(os.PRIO_PROCESS, pid)}"
        except (AttributeError, OSError):
            return "unknown"


def trace_of(path: Path) -> NDArray[np.int64]:
    """What a node kept of its ticks, (T, 9): see `Answers` and the fast node's loop.

    Raises `MeasurementError` if it kept nothing.
    """
    try:
        return np.fromfile(path, np.int64).reshape(-1, 9)
    except OSError:
        raise MeasurementError(f"no stamps in {path}: its node did not end in time") from None
