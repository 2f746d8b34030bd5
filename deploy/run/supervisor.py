"""Starts the processes of a table, watches over them, restarts them, and leaves none behind.

Everything happens in `step()`, on the caller's thread: the kernel's parent-death signal is tied to the thread that
started a child, and that thread must live as long as the supervisor does.
"""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import msgspec

from deploy.run.launch import Launched, answers, environment, launch
from deploy.run.processes import NEEDS_WAIT_S, SHUTDOWN_ORDER, Process
from schemas.runtime.process import CONFIG, FAILED, OK


@dataclass(frozen=True, kw_only=True)
class RestartPolicy:
    """When and how often a process is started again."""

    first_s: float = 0.5
    factor: float = 2.0
    most_s: float = 8.0
    jitter: float = 0.1
    restarts: int = 5
    """More than this many within `window_s` is giving up."""
    window_s: float = 60.0
    grace_s: float = 2.0
    """From SIGTERM to SIGKILL."""

    def delay_s(self, restart: int) -> float:
        """How long to wait before the nth restart in a row (1, 2, ...)."""
        delay = min(self.first_s * self.factor ** (restart - 1), self.most_s)
        return delay * (1.0 + self.jitter * random.random())


State = Literal["waiting", "starting", "ready", "ended", "gave up"]


@dataclass
class Child:
    """One process of the table, through all its restarts."""

    process: Process
    state: State = "waiting"
    launched: Launched | None = None
    due_s: float = 0.0
    """While waiting: when to start it."""
    beat_s: float = 0.0
    """When it was last heard of, or started."""
    restarts: int = 0
    recent: deque[float] = field(default_factory=deque)
    """When it was restarted within the policy's window."""
    probe: threading.Event = field(default_factory=threading.Event)
    """Set by the prober of `probe_url` for each good answer."""


class Supervisor:
    """Watches over the processes of a table. Call `start`, then `step` about 20 times a second, then `stop`.

    `notice` is told in one line of everything a user should know. Heartbeats come in through `beat`.
    """

    def __init__(
        self,
        table: tuple[Process, ...],
        folder: Path,
        notice: Callable[[str], None],
        policy: RestartPolicy | None = None,
    ) -> None:
        self._children = {process.name: Child(process) for process in table}
        self._folder, self._notice = folder, notice
        self._policy = policy or RestartPolicy()
        self._stopped = False
        self._stepped_s = self._started_s = time.monotonic()
        self._closing = threading.Event()

    @property
    def restarts(self) -> dict[str, int]:
        """Restarts so far by process name."""
        return {name: child.restarts for name, child in self._children.items()}

    @property
    def states(self) -> dict[str, State]:
        return {name: child.state for name, child in self._children.items()}

    def probed(self) -> list[tuple[str, int, State]]:
        """(name, process id or 0, state) of those that speak no zenoh, for whom we publish the heartbeat."""
        return [(name, self.pid(name) or 0, c.state) for name, c in self._children.items() if c.process.probe_url]

    def pid(self, name: str) -> int | None:
        """The process id of a running child."""
        launched = self._children[name].launched
        return launched.pid if launched else None

    def start(self) -> None:
        """Begin: each process starts as soon as those that it needs are ready."""
        self._stepped_s = self._started_s = time.monotonic()
        for child in self._children.values():
            if child.process.probe_url:
                threading.Thread(target=self._probe, args=(child,), daemon=True).start()
        self.step()

    def beat(self, name: str, pid: int) -> None:
        """A heartbeat of a node. One that a killed predecessor sent last is not its successor's."""
        child = self._children.get(name)
        if child is None or child.process.probe_url:
            return
        if child.launched is not None and child.launched.pid == pid:
            self._heard(child, time.monotonic())

    def step(self, hears: bool = True) -> int | None:
        """Look after every child once, without waiting. Returns the exit code once the run is over, else None.

        hears: whether heartbeats can reach us; while they cannot, nobody's silence counts.
        """
        now = time.monotonic()
        stall = now - self._stepped_s
        self._stepped_s = now
        if stall > 1.0 or not hears:  # it is us who slept (a suspended host) or are deaf: nobody need have been silent
            for child in self._children.values():
                child.beat_s += stall
        for child in self._children.values():
            code = self._look_after(child, now)
            if code is not None:
                return code
        return None

    def _look_after(self, child: Child, now: float) -> int | None:
        if child.state in ("ended", "gave up"):
            return None
        if child.launched is None:
            if now >= child.due_s and self._needs_met(child, now):
                self._spawn(child, now)
            return None
        code = child.launched.exit_code()
        if code is not None:
            self._kill(child)  # whatever it started itself
            return self._exited(child, code, now)
        if child.probe.is_set():
            child.probe.clear()
            self._heard(child, now)
        limit = child.process.heartbeat_s if child.state == "ready" else child.process.start_s
        if now - child.beat_s > limit:
            self._kill(child)
            return self._failed(child, f"silent for {limit:g} s, killed", now)
        return None

    def _needs_met(self, child: Child, now: float) -> bool:
        needs = [self._children[name] for name in child.process.needs if name in self._children]
        waited_s = now - self._started_s
        return all(
            need.state == "ready" or waited_s > (need.process.start_s if need.process.critical else NEEDS_WAIT_S)
            for need in needs
        )

    def _heard(self, child: Child, now: float) -> None:
        child.beat_s = now
        if child.state == "starting":
            child.state = "ready"
            if child.restarts:
                self._notice(f"{child.process.name} is back")

    def _spawn(self, child: Child, now: float) -> None:
        process = child.process
        child.launched = launch(
            process.name,
            process.argv,
            self._folder / f"{process.name}.jsonl",
            env=environment(*process.secrets),
            append=True,
            stdout=False,
            nice=process.nice,
        )
        child.probe.clear()
        child.state, child.beat_s = "starting", now

    def _exited(self, child: Child, code: int, now: float) -> int | None:
        name = child.process.name
        if code == OK and child.process.finishes:
            child.state = "ended"
            return OK
        if code == CONFIG:  # it would only say the same again
            self._notice(f"{name} cannot start: {self.last_words(name) or 'bad configuration'}")
            child.state = "gave up"
            return CONFIG if child.process.critical else None
        return self._failed(child, f"exited with code {code}" if code >= 0 else f"killed by signal {-code}", now)

    def _failed(self, child: Child, what: str, now: float) -> int | None:
        """Restart the child later, or give it up. Returns the exit code of the run if that ends it."""
        name, recent = child.process.name, child.recent
        while recent and now - recent[0] > self._policy.window_s:
            recent.popleft()
        if len(recent) >= self._policy.restarts:
            words = self.last_words(name)
            why = f"{name} {what}, after {len(recent)} restarts{f' ({words})' if words else ''}"
            child.state = "gave up"
            if child.process.critical:
                self._notice(f"{why}: nothing can drive without it, stopping; see {self._folder / name}.jsonl")
                return FAILED
            self._notice(f"{why}: going on without it; see {self._folder / name}.jsonl")
            return None
        recent.append(now)
        child.restarts += 1
        delay = self._policy.delay_s(len(recent))
        child.state, child.due_s = "waiting", now + delay
        self._notice(f"{name} {what}; restarting in {delay:.1f} s")
        return None

    def last_words(self, name: str) -> str:
        """The detail of the last line that a process logged."""
        try:
            lines = (self._folder / f"{name}.jsonl").read_bytes()[-8192:].splitlines()
        except OSError:
            return ""
        last = lines[-1] if lines else b""
        try:
            fields = msgspec.json.decode(last, type=dict[str, object])
        except (msgspec.DecodeError, UnicodeDecodeError):
            return last.decode(errors="replace")[:200]
        return str(fields.get("detail") or fields.get("event") or "")[:300]

    def _probe(self, child: Child) -> None:
        while not self._closing.wait(1.0 if child.state == "ready" else 0.25):
            if answers(child.process.probe_url, 2.0):
                child.probe.set()

    def _kill(self, child: Child) -> None:
        """SIGKILL to the child's whole process group, at once."""
        if child.launched is not None:
            child.launched.kill()
            child.launched = None

    def kill(self) -> None:
        """End everything at once. Safe in a signal handler: it waits for nobody."""
        for child in self._children.values():
            if child.launched is not None:
                child.launched.signal(signal.SIGKILL)

    def stop(self, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Ordered shutdown: each process gets SIGTERM, `grace_s` to finish, then SIGKILL. Calls `meanwhile` often."""
        if self._stopped:
            return
        self._stopped = True
        self._closing.set()
        order = {name: place for place, name in enumerate(SHUTDOWN_ORDER)}
        for child in sorted(self._children.values(), key=lambda c: order.get(c.process.name, -1)):
            if child.state != "gave up":
                child.state = "ended"
            if child.launched is not None:
                child.launched.end(self._policy.grace_s, meanwhile)
                child.launched = None


class Signals:
    """The signals that have come so far. The first asks for an ordered shutdown, the second ends all at once."""

    def __init__(self) -> None:
        self.first = 0


@contextmanager
def catch_signals(kill: Callable[[], None]) -> Iterator[Signals]:
    """Note the first SIGINT, SIGTERM or SIGHUP; on a second one call `kill` and leave with its code."""
    caught = Signals()

    def handle(number: int, _: object) -> None:
        if caught.first:
            kill()
            os._exit(128 + number)
        caught.first = number

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield caught
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
