"""Launches processes and ends them: the only place where a process of ours is started.

A launched process leads a process group of its own, and a session unless told otherwise. So Ctrl-C in a terminal
reaches the launcher alone, which ends the others in its own order, and what a process has started itself ends with it.
Should the launcher be killed outright, our own programs end too: they ask the kernel for that first
(`die_with_parent`).
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from http.client import HTTPException
from pathlib import Path
from typing import IO, Protocol

import msgspec

from schemas.runtime.bus import ONE_POOL
from schemas.runtime.errors import ConfigError
from slow_node.config import TOKEN

GRACE_S = 3.0
"""From SIGTERM to SIGKILL."""
POLL_S = 0.01
NOWHERE = Path(os.devnull)
_ROOT = Path(__file__).resolve().parents[2]


KEY = "OPENAI_API_KEY"
SECRETS = (KEY, TOKEN, "OTEL_EXPORTER_OTLP_HEADERS", "OTEL_EXPORTER_OTLP_TRACES_HEADERS")
"""Environment variables that a program of ours gets only if it needs them."""


@cache
def model_token() -> str:
    """What the embedded model's server is to be shown, where this process starts it. Who needs it else is told by
    `environment`; it is not in our own, which all would have that we start."""
    return secrets.token_urlsafe(24)


def environment(*needed: str) -> dict[str, str]:
    """For our own programs: they run the source that this one runs, wherever it was started.

    needed: which of `SECRETS` they get.
    """
    hidden = set(SECRETS) - set(needed)
    inherited = {k: v for k, v in os.environ.items() if k not in hidden}
    if inherited.get("ZENOH_RUNTIME") == ONE_POOL:  # set by `open_bus`
        del inherited["ZENOH_RUNTIME"]
    paths = [str(_ROOT), *inherited.get("PYTHONPATH", "").split(os.pathsep)]
    return {
        # The nodes compute on small arrays: a pool of BLAS threads per node only makes the ticks jitter.
        **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
        "PYGAME_HIDE_SUPPORT_PROMPT": "1",
        **inherited,
        **({TOKEN: model_token()} if TOKEN in needed else {}),
        "PYTHONPATH": os.pathsep.join(dict.fromkeys(filter(None, paths))),
    }


def python_module(module: str, config: Mapping[str, object] | msgspec.Struct) -> tuple[str, ...]:
    """The command of a program whose only argument is its configuration as JSON, in ASCII: a locale may have no more.

    It imports nothing from the current folder, where a user may have a `schemas` or `deploy` of his own.
    """
    return sys.executable, "-P", "-m", module, json.dumps(config, default=msgspec.to_builtins)


@dataclass(frozen=True)
class Launched:
    """A process, leader of its own group, and the file that it writes to."""

    name: str
    popen: subprocess.Popen[bytes]
    log: Path

    @property
    def pid(self) -> int:
        return self.popen.pid

    def exit_code(self) -> int | None:
        """None while it runs; negative: the signal that killed it."""
        return self.popen.poll()

    def trouble(self) -> str:
        """How it ended, with its last line; empty while it runs."""
        code = self.exit_code()
        if code is None:
            return ""
        how = f"ended with code {code}" if code >= 0 else f"was killed by signal {-code}"
        return f"its {self.name} {how}{self.last_line()}"

    def last_line(self) -> str:
        """`: ` and the last line it wrote, or nothing."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return f": {lines[-1].strip()[:200]}" if lines else ""

    def signal(self, number: int) -> None:
        """Send a signal to its whole group. Waits for nobody, so it may be called in a signal handler."""
        try:
            os.killpg(self.pid, number)
        except (ProcessLookupError, PermissionError):  # macOS says the latter of a group of zombies
            pass

    def kill(self) -> None:
        """End its whole group at once, and wait for it."""
        self.signal(signal.SIGKILL)
        self.popen.wait()

    def end(self, grace_s: float = GRACE_S, meanwhile: Callable[[], None] = lambda: None) -> None:
        """SIGTERM, `grace_s` seconds to finish, then SIGKILL. Calls `meanwhile` often."""
        end_all((self,), grace_s, meanwhile)


def end_all(
    launched: Sequence[Launched], grace_s: float = GRACE_S, meanwhile: Callable[[], None] = lambda: None
) -> None:
    """End all at the same time, as `Launched.end` does."""
    for process in launched:
        process.signal(signal.SIGTERM)
    deadline = time.monotonic() + grace_s
    while any(process.exit_code() is None for process in launched) and time.monotonic() < deadline:
        meanwhile()
        time.sleep(POLL_S)
    for process in launched:
        process.kill()


def launch(
    name: str,
    argv: Sequence[str],
    log: Path = NOWHERE,
    *,
    env: Mapping[str, str] | None = None,
    append: bool = False,
    stdout: bool = True,
    nice: int = 0,
    own_session: bool = True,
) -> Launched:
    """Start a process.

    log: where it writes to, anew unless `append`; stdout: as well as stderr. env: `environment()` by default.
    nice: its niceness, if it is granted. own_session: Linux shares the processor out among sessions first.
    A log that cannot be opened is not kept. Raises OSError if the program cannot be started.
    """
    with _opened(log, append) as file:
        popen = subprocess.Popen(
            argv,
            stdin=subprocess.DEVNULL,
            stdout=file if stdout else subprocess.DEVNULL,
            stderr=file,
            env=environment() if env is None else env,
            start_new_session=own_session,
            process_group=None if own_session else 0,
        )
    if nice:
        try:
            os.setpriority(os.PRIO_PROCESS, popen.pid, nice)
        except OSError:  # it has ended already; whoever watches over it sees that
            pass
    return Launched(name, popen, log)


def _opened(log: Path, append: bool) -> IO[bytes]:
    try:
        return log.open("ab" if append else "wb")
    except OSError:  # the disk is full or read-only
        return open(os.devnull, "ab")


SHORT = re.compile(r"[\w./+-]{1,60}", re.ASCII)
"""A folder whose Unix sockets have a legal name: of less than 108 characters, and none that means more to zenoh."""
_REMOVE = 'read -r _; rm -rf -- "$0" || { sleep 1; rm -rf -- "$0"; }'
"""In a shell: once the other end of its stdin is gone, remove the folder, even if a dying process still wrote to it."""


@contextmanager
def temporary_folder(prefix: str = "fastslow-") -> Iterator[Path]:
    """A folder for sockets that is gone with the block, or with this process, however it ends.

    Raises `ConfigError` where there is none to be had.
    """
    folder = _new_folder(prefix)
    watch = None
    with suppress(OSError):  # without a shell, a killed run leaves its folder
        watch = subprocess.Popen(
            ("/bin/sh", "-c", _REMOVE, str(folder)),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if watch is not None:
            watch.kill()
            watch.communicate()


def _new_folder(prefix: str) -> Path:
    """In the user's folder for temporary files, or in the machine's where that one is of no use for sockets."""
    usual = os.environ.get("TMPDIR") or "/tmp"
    tried = [folder for folder in dict.fromkeys((usual, "/tmp", "/var/tmp")) if SHORT.fullmatch(folder)]
    for folder in tried:
        with suppress(OSError):
            return Path(tempfile.mkdtemp(prefix=prefix, dir=folder))
    raise ConfigError("no folder for temporary files that can hold a socket: set TMPDIR to a short one of your own")


class Start(Protocol):
    """`launch`, for what ends with a block."""

    def __call__(
        self, name: str, argv: Sequence[str], log: Path, *, env: Mapping[str, str] | None = None
    ) -> Launched: ...


@contextmanager
def children() -> Iterator[Start]:
    """Yields what launches a process; all of them end with the block, with all that they started."""
    started: list[Launched] = []

    def start(name: str, argv: Sequence[str], log: Path, *, env: Mapping[str, str] | None = None) -> Launched:
        started.append(launch(name, argv, log, env=env))
        return started[-1]

    try:
        yield start
    finally:
        end_all(started)


_DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))


def answers(url: str, timeout_s: float = 1.0) -> bool:
    """Whether a server on this host answers a GET with HTTP 200; no proxy is asked."""
    try:
        with _DIRECT.open(url, timeout=timeout_s) as response:
            return bool(response.status == 200)
    except (OSError, HTTPException):
        return False
