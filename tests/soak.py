"""`make soak`: drives for hours while it is killed, spoken to, looked at and lied to; `reports/soak.md` and `.json`.

    python -m tests.soak [PART ...] [--scale 0.1]

The parts, each a run of its own that writes its row when it is done:

* `kills`: 30 minutes, and every 20 s one process is killed, each in its turn;
* `memory`: the slow node is killed 200 times, just as it writes into its memory bank; the supervisor last;
* `quiet`: an hour with a passenger, the recorder, and the cockpit's page open in a browser;
* `fuzz`: ten minutes with a stranger who comes in by the door and puts damaged messages on every topic.

A shorter run of less than ten minutes says its slopes, but is not judged by them. With `--shared`, on a machine that
others load, what runs when nobody else wants the core (recorder, cockpit, embedded model) gets a share like theirs.
"""

from __future__ import annotations

import argparse
import os
import platform
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import psutil

from deploy.run.launch import temporary_folder
from deploy.run.processes import TCP_HOST, free_port
from schemas.runtime.bus import ZenohBus
from schemas.wire import topics
from schemas.wire.codec import encode
from schemas.wire.messages import Command
from tests.driving import client, ended
from tests.running import ROOT
from tests.soak_browser import page_of
from tests.soak_meter import Meter
from tests.soak_report import REPORT, write

LOOK_EVERY_S = 5.0
SPEAK_EVERY_S = 45.0
KILL_EVERY_S = 20.0
TOLD = 10
"""Troubles of a run, the last ones."""
VICTIMS = ("fast", "slow", "sim", "llm", "record", "cockpit", "door")
SAYINGS = (
    "I'm in a hurry to get to work, I want to drive faster", "please slow down a little", "change to the left lane",
    "keep more distance, please", "how fast are we going?", "overtake that car", "never mind", "move to the right",
)  # fmt: skip
DRIVE = """
from deploy.run.processes import RunOptions
from deploy.run.supervisor import RestartPolicy
from deploy.run.system import run_system
raise SystemExit(run_system(RunOptions(**{options!r}), policy=RestartPolicy(**{policy!r})))
"""


@dataclass
class Drive:
    """A run, a client on its bus, and what it is measured with."""

    process: subprocess.Popen[str]
    folder: Path
    bus: ZenohBus
    meter: Meter
    began_s: float = field(default_factory=time.monotonic)
    said: int = 0
    pids: dict[str, int] = field(default_factory=dict)
    """Of every process that says it is ready."""
    gone: set[int] = field(default_factory=set)
    """Those that were killed: what they said last may still be on its way."""
    page: str = ""
    shared: bool = False

    def __post_init__(self) -> None:
        self._beats, self._replies = self.bus.subscribe(topics.STATUS), self.bus.subscribe(topics.REPLY)
        self.answered: set[int] = set()
        self._spoke_s = self._looked_s = self._shared_s = 0.0

    def read(self) -> None:
        for beat in self._beats.take():
            if beat.state in ("ready", "degraded") and beat.pid not in self.gone:
                self.pids[beat.node] = beat.pid
            if beat.node == "cockpit" and beat.metrics.get("port"):
                self.page = f"http://{TCP_HOST}:{beat.metrics['port']:.0f}/"
        self.answered |= {reply.command_id for reply in self._replies.take()}

    def say(self, text: str) -> None:
        self.said += 1
        command = Command(epoch=0, stamp_ns=time.monotonic_ns(), id=self.said, text=text, source="soak")
        self.bus.publish(topics.COMMAND, command)

    def go_on(self, speaks: bool = True) -> None:
        """A twentieth of a second: what has come is read, what is due is said and measured."""
        assert self.process.poll() is None, f"the run ended with code {self.process.returncode}"
        self.read()
        now_s = time.monotonic()
        if speaks and now_s - self._spoke_s > SPEAK_EVERY_S:
            self._spoke_s = now_s
            self.say(SAYINGS[self.said % len(SAYINGS)])
        if now_s - self._looked_s > LOOK_EVERY_S:
            self._looked_s = now_s
            self.meter.look()
        if self.shared and now_s - self._shared_s > 1.0:
            self._shared_s = now_s
            for process in self.meter.family():
                weigh(process.pid)
        time.sleep(0.05)

    def until(self, condition: Callable[[], bool], patience_s: float = 300.0, speaks: bool = False) -> float:
        """Go on until it holds; how long that took [s]."""
        began_s = time.monotonic()
        while not condition():
            assert time.monotonic() - began_s < patience_s, "it does not happen"
            self.go_on(speaks)
        return time.monotonic() - began_s

    def kill(self, name: str) -> None:
        """SIGKILL a process of the run, and forget it until it says that it is ready again."""
        pid = self.pids.pop(name)
        if pid in {child.pid for child in self.meter.family()}:
            os.kill(pid, signal.SIGKILL)
        self.gone.add(pid)

    def end(self) -> dict[str, Any]:
        return ended(self.process)


def weigh(pid: int) -> None:
    """Give the session of a process the usual weight among sessions (Linux)."""
    with suppress(OSError):  # it has ended, or we may not
        Path(f"/proc/{pid}/autogroup").write_text("0")


@contextmanager
def driving(seconds: float, shared: bool, policy: dict[str, float] | None = None, **options: Any) -> Iterator[Drive]:
    """A run in a folder of its own, with its temporary files and its memory bank, once it drives.

    shared: others load this machine.
    """
    port = free_port()
    options = {"port": port, "as_json": True, "seed": 3, "scenario": "highway", **options}
    code = DRIVE.format(options=options, policy=policy or {})
    with temporary_folder("soak-") as folder:
        (folder / "tmp").mkdir()
        known = {"PYTHONPATH": str(ROOT), "FASTSLOW_DATA": str(folder / "data"), "TMPDIR": str(folder / "tmp")}
        process = subprocess.Popen(
            [sys.executable, "-c", code],
            cwd=folder,
            env=os.environ | known,
            text=True,
            stdout=subprocess.PIPE,
            stderr=(folder / "said").open("wb"),
        )
        try:
            with client(port, process) as bus:
                drive = Drive(process, folder, bus, Meter(process.pid, folder, seconds), shared=shared)
                drive.until(lambda: {"sim", "fast"} <= set(drive.pids))
                yield drive
        finally:
            process.kill()
            process.communicate(timeout=60)


def result(part: str, drive: Drive, did: dict[str, Any], summary: dict[str, Any] | None) -> dict[str, Any]:
    """The row of a part whose run has ended, without its verdict."""
    minutes = (time.monotonic() - drive.began_s) / 60.0
    counted = ("ticks", "answered", "collisions", "failsafes", "episodes", "restarts", "restarts_of", "modes")
    kept = {name: summary[name] for name in counted} if summary else {}
    if summary:
        kept["modes"] = dict(Counter(mode["mode"] for mode in kept["modes"]))
    return {
        "part": part,
        "minutes": round(minutes, 1),
        "began": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC less {minutes:.0f} min",
        "did": did | {"commands": drive.said, "commands_answered": len(drive.answered & set(range(drive.said + 1)))},
        "summary": kept,
        "processes": drive.meter.told(),
        "disk": drive.meter.disk.told() if drive.meter.disk.at_s else {},
        "troubles": [line.strip() for line in _said(drive.folder) if "restarting" in line or "without" in line][-TOLD:],
        "largest_mb": {k: round(v / 1e6, 2) for k, v in sorted(drive.meter.largest.items()) if v > 1e5},
        "left": drive.meter.left(),
    }


def _said(folder: Path) -> list[str]:
    """What the run has told people."""
    return (folder / "said").read_text(errors="replace").splitlines()


def kills(scale: float, shared: bool) -> dict[str, Any]:
    seconds = 1800.0 * scale
    killed = dict.fromkeys(VICTIMS, 0)
    back_s: dict[str, list[float]] = {name: [] for name in VICTIMS}
    with driving(seconds, shared, cockpit_port=0) as drive:
        drive.until(lambda: set(VICTIMS) <= set(drive.pids))
        for turn in range(max(1, round(seconds / KILL_EVERY_S))):
            victim, due_s = VICTIMS[turn % len(VICTIMS)], time.monotonic() + KILL_EVERY_S
            drive.kill(victim)
            killed[victim] += 1
            took_s = drive.until(lambda: victim in drive.pids, speaks=True)  # noqa: B023
            back_s[victim].append(round(took_s, 2))
            drive.until(lambda: time.monotonic() > due_s, speaks=True)  # noqa: B023
        summary = drive.end()
        did = {"killed": killed, "back_s_most": {name: max(took) for name, took in back_s.items() if took}}
        return result("kills", drive, did, summary)


def memory(scale: float, shared: bool) -> dict[str, Any]:
    times = max(2, round(200 * scale))
    policy = {"first_s": 0.2, "factor": 1.0, "restarts": 10**6}
    rng, written, sound, rows = random.Random(0), 0, 0, 0
    with driving(times * 6.0, shared, policy, cockpit_port=None, without=("llm", "record")) as drive:
        bank = drive.folder / "data/memory.sqlite"
        for turn in range(times):
            drive.until(lambda: "slow" in drive.pids)
            before, give_up_s = _stamp(bank), time.monotonic() + 20.0
            drive.say(f"drive at {70 + turn % 40} km/h")
            while _stamp(bank) == before and time.monotonic() < give_up_s:
                time.sleep(0.0005)
            written += _stamp(bank) != before
            time.sleep(rng.uniform(0.0, 0.003))
            drive.kill("slow")
            rows = _rows_if_sound(bank)
            sound += rows > 0
            drive.go_on(speaks=False)
        drive.until(lambda: "slow" in drive.pids)
        drive.meter.look()
        drive.process.kill()
        did = {"killed": times, "while_it_wrote": written, "bank_sound": sound, "examples_at_the_end": rows}
        return result("memory", drive, did, None)


def _stamp(bank: Path) -> tuple[int, ...]:
    """Changes when something is written into the bank."""
    there = [path.stat() for path in (bank, bank.with_name(bank.name + "-wal")) if path.exists()]
    return tuple(value for stat in there for value in (stat.st_size, stat.st_mtime_ns))


def _rows_if_sound(bank: Path) -> int:
    """How many examples a bank has; 0 where it is damaged."""
    try:
        with sqlite3.connect(f"file:{bank}?mode=ro", uri=True, timeout=10.0) as db:
            whole = db.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
            count = int(db.execute("SELECT count(*) FROM experience").fetchone()[0])
        db.close()
    except sqlite3.Error:
        return 0
    return count if whole else 0


def quiet(scale: float, shared: bool) -> dict[str, Any]:
    seconds = 3600.0 * scale
    with driving(seconds, shared, cockpit_port=0) as drive:
        drive.until(lambda: bool(drive.page) and "slow" in drive.pids)
        with page_of(drive.page) as page:
            until_s, look_s = time.monotonic() + seconds, 0.0
            while time.monotonic() < until_s:
                drive.go_on()
                page.breathe()
                if time.monotonic() - look_s > 6 * LOOK_EVERY_S:
                    look_s = time.monotonic()
                    page.look()
            did: dict[str, Any] = {"page": page.told()}
            summary = drive.end()
        return result("quiet", drive, did, summary)


def fuzz(scale: float, shared: bool) -> dict[str, Any]:
    seconds, rng, sent = 600.0 * scale, random.Random(0), 0
    with driving(seconds, shared, cockpit_port=0) as drive:
        drive.until(lambda: "slow" in drive.pids)
        heard, genuine = drive.bus.subscribe_all(64), [encode(Command(epoch=0, stamp_ns=0, id=1, text="x"))]
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            genuine = ([arrival.payload for arrival in heard.take()] + genuine)[:200]
            for _ in range(20):
                drive.bus.publish_bytes(rng.choice(topics.TOPICS), damaged(rng, rng.choice(genuine)))
                sent += 1
            drive.go_on()
        summary = drive.end()
        did = {"damaged_messages": sent, "refused": summary["refused_payloads"]}
        return result("fuzz", drive, did, summary)


def damaged(rng: random.Random, payload: bytes) -> bytes:
    """A message with bytes changed, cut off, repeated, made up, or much too long."""
    raw = bytearray(payload)
    how = rng.randrange(5)
    if how == 0 and raw:
        for _ in range(rng.randint(1, 8)):
            raw[rng.randrange(len(raw))] = rng.randrange(256)
    elif how == 1:
        del raw[rng.randint(0, len(raw)) :]
    elif how == 2:
        raw = raw * 2
    elif how == 3:
        raw = bytearray(rng.randbytes(rng.randint(0, 2000)))
    elif rng.random() < 0.05:
        raw = bytearray(rng.randbytes(100_000))
    return bytes(raw)


Part = Callable[[float, bool], dict[str, Any]]
PARTS: dict[str, Part] = {"kills": kills, "memory": memory, "quiet": quiet, "fuzz": fuzz}


def driven(part: str, scale: float, shared: bool) -> dict[str, Any]:
    """The row of a part; of one that breaks off, a row that says why."""
    began_s = time.monotonic()
    try:
        return PARTS[part](scale, shared)
    except (AssertionError, subprocess.SubprocessError) as error:
        minutes = round((time.monotonic() - began_s) / 60.0, 1)
        nothing: dict[str, Any] = {name: {} for name in ("did", "summary", "processes", "disk", "largest_mb", "left")}
        return nothing | {"part": part, "minutes": minutes, "broken_off": str(error)}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.soak")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all by default")
    parser.add_argument("--scale", type=float, default=1.0, help="times the full length")
    parser.add_argument("--report", type=Path, default=REPORT)
    parser.add_argument("--shared", action="store_true", help="others load this machine")
    asked = parser.parse_args()
    if unknown := sorted(set(asked.parts) - set(PARTS)):
        parser.error(f"no part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    if not 0.0 < asked.scale <= 100.0:
        parser.error("--scale is a number above 0")
    bad = 0
    for part in asked.parts or PARTS:
        load = psutil.getloadavg()[2]
        row = driven(part, asked.scale, asked.shared)
        loads = f"load average {load:.1f} before, {psutil.getloadavg()[2]:.1f} after"
        whose = " (shared with others)" if asked.shared else ""
        row["machine"] = f"{platform.machine()}, {psutil.cpu_count()} cores, {loads}{whose}"
        write(row, asked.report)
        print(f"{part}: {row['verdict']} {'; '.join(row['wrong'])}", flush=True)
        bad += bool(row["wrong"])
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
