"""A car that drives, and a client that came through its door, for tests."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy.run.processes import TCP_HOST, free_port, listener_of
from schemas.runtime.bus import BusConfig, ZenohBus, open_bus
from schemas.wire import topics
from schemas.wire.messages import Observation
from tests.running import start
from tests.waiting import until


@dataclass
class Drive:
    """A run, and a client on its bus."""

    process: subprocess.Popen[str]
    bus: ZenohBus

    def __post_init__(self) -> None:
        self.seen = self.bus.subscribe(topics.OBSERVATION)
        until(lambda: self.seen.peek() is not None, "nothing drives")

    @property
    def newest(self) -> Observation:
        found = self.seen.peek()
        assert found is not None
        return found

    def applies_actions(self) -> bool:
        """Whether the newest tick but one was answered."""
        return 0 <= self.newest.applied_tick == self.newest.tick - 1

    def end(self) -> dict[str, Any]:
        return ended(self.process)


def ended(process: subprocess.Popen[str]) -> dict[str, Any]:
    """The summary of a run, which is ended now."""
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    summary: dict[str, Any] = json.loads(out)
    return summary


@contextmanager
def client(port: int, process: subprocess.Popen[str]) -> Iterator[ZenohBus]:
    """A client of a run, once somebody listens at its port."""
    until(lambda: listener_of(port) or process.poll() is not None, "nobody listens")
    assert process.poll() is None, f"the run ended with code {process.returncode}"
    with open_bus(BusConfig(mode="client", connect=(f"tcp/{TCP_HOST}:{port}",))) as bus:
        yield bus


@contextmanager
def driving(folder: Path, *more: str) -> Iterator[Drive]:
    """On the highway, without slow node and cockpit, until the block ends."""
    port = free_port()
    process = start(folder, "--port", str(port), "--scenario", "highway", "--without", "slow", "--no-cockpit", *more)
    try:
        with client(port, process) as bus:
            yield Drive(process, bus)
    finally:
        process.kill()
        process.communicate(timeout=60)
