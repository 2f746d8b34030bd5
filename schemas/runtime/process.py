"""A node's life: signals, parent's death, JSON-line log, heartbeat, readable failures."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

import msgspec

from schemas.runtime.bus import Bus, BusConfig
from schemas.runtime.errors import ConfigError as ConfigError
from schemas.runtime.realtime import Mode
from schemas.wire import topics
from schemas.wire.messages import Mode as DrivingMode
from schemas.wire.messages import Status
from schemas.wire.text import plain

OK, FAILED, USAGE, UNAVAILABLE, TRY_AGAIN, CONFIG = 0, 1, 2, 69, 75, 78
"""Exit codes: see the README's table. 130 and 143 are the signals' own."""

C = TypeVar("C", bound=msgspec.Struct)


class Stopped(BaseException):
    """Raised in the main thread by the first SIGINT or SIGTERM; carries the exit code."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def load_config(kind: type[C], argv: list[str]) -> C:
    """A node's configuration from its one argument, a JSON object. Unknown keys and bad values are `ConfigError`s."""
    if len(argv) != 1 or argv[0] in ("-h", "--help"):
        fields = ", ".join(f.name for f in msgspec.structs.fields(kind))
        raise ConfigError(f"give one JSON object with any of: {fields}")
    try:
        return msgspec.json.decode(argv[0], type=kind)
    except (msgspec.DecodeError, ValueError) as error:
        raise ConfigError(f"configuration of {kind.__name__}: {error}") from None


def die_with_parent() -> None:
    """Have the kernel kill this process when its parent dies, however that happens (Linux; elsewhere: no effect)."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


@contextmanager
def stop_on_signals() -> Iterator[None]:
    """Raise `Stopped` in the main thread on the first SIGINT or SIGTERM; a second one ends the process at once."""

    def stop(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise Stopped(128 + number)

    before = {s: signal.signal(s, stop) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_node(name: str, main: Callable[[], None]) -> int:
    """Run a node's main function to its end and return the exit code; a user's mistake is one line, not a traceback."""
    die_with_parent()
    try:
        with stop_on_signals():
            main()
    except Stopped:
        return OK  # an ordered shutdown is a success for a node; the supervisor reports the signal
    except ConfigError as error:
        log(name, "config", str(error))
        return CONFIG
    return OK


def log(node: str, event: str, detail: str = "", **fields: object) -> None:
    """One JSON line on stderr, which the supervisor keeps in the run folder; lost where that cannot be written."""
    said = {"detail": detail} if detail else {}
    line = {"t_ns": time.monotonic_ns(), "node": node, "event": event, **said, **fields}
    with suppress(OSError):  # a full disk, or nobody who reads: no reason to end
        print(json.dumps(line), file=sys.stderr, flush=True)


QUIET_WAIT_S = 0.1
"""How long a beat waits for a tick to end: longer than one tick at 15 Hz."""
TOLD_FOR_S = 10.0
"""So long the heartbeat names the last payload that was refused."""
QUIET_S = 0.01
"""From a tick's end to the beat: by then the answer to it has arrived, and the next tick is far."""


class Heartbeat:
    """Publishes `Status` at the topic's rate from a thread of its own, as long as the node's loop makes progress.

    The loop brackets its work with `working()`; a loop stuck inside one for more than `stuck_s` lets the heart stop,
    and the supervisor sees it. Waiting for a message is not being stuck. A beat goes out a little after a tick's work
    has ended, never during a tick: it would hold the interpreter while the tick's answer arrives.
    """

    def __init__(self, bus: Bus, node: str, metrics: Callable[[], dict[str, float]], stuck_s: float = 1.0) -> None:
        self._bus, self._node, self._metrics, self._stuck_s = bus, node, metrics, stuck_s
        self._busy_since: float | None = None
        self._stop = threading.Event()
        self._ended = threading.Event()
        self._seq = 0
        self._refused, self._told, self._told_s = 0, "", -TOLD_FOR_S
        self.epoch = 0
        self.state: str = "ready"
        self.mode: tuple[DrivingMode | None, str, int] = (None, "", 0)
        """How the car is driven, why and since when; of the simulator alone."""
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)

    def __enter__(self) -> Heartbeat:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(timeout=1.0)

    def begin(self) -> None:
        self._busy_since = time.monotonic()

    def end(self) -> None:
        self._busy_since = None
        self._ended.set()

    def _refusals(self) -> str:
        """What was wrong with the payloads that could not be used, as long as there are any; logged once a second."""
        total, now_s = sum(self._bus.faults.values()), time.monotonic()
        if total != self._refused and now_s - self._told_s >= 1.0:
            self._told = f"{total - self._refused} payloads refused, the last on {plain(self._bus.last_fault, 200)}"
            self._refused, self._told_s = total, now_s
            log(self._node, "payload", self._told)
        return self._told if now_s - self._told_s < TOLD_FOR_S else ""

    def _beat(self) -> None:
        period = 1.0 / (topics.STATUS.hz or 5.0)
        while not self._stop.wait(period - QUIET_WAIT_S):
            self._ended.clear()
            self._ended.wait(QUIET_WAIT_S)
            if self._stop.wait(QUIET_S):
                return
            busy_since = self._busy_since
            if busy_since is not None and time.monotonic() - busy_since > self._stuck_s:
                continue
            self._seq += 1
            metrics, detail = self._metrics(), self._refusals()
            if self._refused:
                metrics["refused_payloads"] = float(self._refused)
            self._bus.publish(
                topics.STATUS,
                Status(
                    epoch=self.epoch,
                    stamp_ns=time.monotonic_ns(),
                    node=self._node,
                    pid=os.getpid(),
                    seq=self._seq,
                    state=self.state,  # type: ignore[arg-type]
                    metrics=metrics,
                    detail=detail,
                    mode=self.mode[0],
                    mode_why=self.mode[1],
                    mode_since_ns=self.mode[2],
                ),
            )


def revision() -> str | None:
    """The source's git commit, with -dirty when it was changed; None where it is no checkout or there is no git."""
    import subprocess  # no node needs it, and each would pay for it at its start

    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    try:
        asked = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--exclude", "*"],
            cwd=root,
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return asked.stdout.strip()


class Trace:
    """Rows of integers about each tick, kept in memory and written at the end: the benchmark's view into a node."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._rows = array("q")

    def add(self, *row: int) -> None:
        """Keep a row; all rows of one trace have the same length. Without a path: nothing."""
        if self._path:
            self._rows.extend(row)

    def save(self) -> None:
        """Write the rows as little-endian int64, if there is a path."""
        if self._path:
            Path(self._path).write_bytes(self._rows.tobytes())


class NodeConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What every node's configuration has; a node's own `config.py` appends to it."""

    bus: BusConfig = BusConfig()
    realtime: Mode = "off"
    """Scheduling of a latency-critical node; see `schemas.runtime.realtime`."""
    trace: str = ""
    """Where to write the stamps of every tick; empty: nowhere."""
