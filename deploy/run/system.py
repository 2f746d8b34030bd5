"""One run of the whole system: the router session, the supervisor, what is shown and what is kept of it."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import secrets
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path

from deploy.run.hearing import Hearing
from deploy.run.launch import temporary_folder
from deploy.run.logs import SUMMARY, SUPERVISOR, open_log, prune, rotate
from deploy.run.model_choice import choose_model
from deploy.run.processes import (
    TCP_HOST,
    Process,
    RunOptions,
    data_folder,
    door_of,
    free_port,
    is_free,
    links_of,
    listener_of,
    process_table,
    road_of,
    speak_to,
)
from deploy.run.status import COLUMNS, Live, happened
from deploy.run.summary import Summary
from deploy.run.supervisor import RestartPolicy, Supervisor, catch_signals
from schemas.runtime.bus import Bus, BusError, open_bus
from schemas.runtime.clock import NS
from schemas.runtime.process import CONFIG, FAILED, OK, TRY_AGAIN, ConfigError
from schemas.runtime.realtime import trial
from schemas.wire import topics
from schemas.wire.codec import Fault, decode_command
from schemas.wire.messages import Command, Status
from schemas.wire.text import printable

STEP_S = 0.05
OVERTIME_S = 5.0
"""The simulator ends a run of given duration itself; the supervisor ends it when that is this late."""
START_WAIT_S = 20.0
"""A run counts as begun after this long even if the slow node is not ready; without sim and fast there is none. Where
nothing is compiled yet, sim takes longer than this."""
PLAIN = -1
"""The id of a command that came as plain text."""


def run_system(
    options: RunOptions, table: tuple[Process, ...] | None = None, policy: RestartPolicy | None = None
) -> int:
    """Run to the end and return the exit code. `table` and `policy` are for tests; the sockets are then the caller's.

    Data goes to stdout: the summary, with `as_json` alone, else the live lines as well.
    """
    try:
        with contextlib.suppress(OSError):  # without it nothing is remembered, as the slow node says
            data_folder().mkdir(parents=True, exist_ok=True)
        options = replace(options, port=options.port or free_port())
        if _taken(options):
            return TRY_AGAIN
        model = choose_model(options.model)
        road_of(options.scenario)  # a missing file is told before there is a run
        if options.record:
            _try_to_write(options.record)
        if options.foxglove and find_spec("foxglove") is None:
            raise ConfigError("foxglove-sdk is missing: pip install 'fastslow[foxglove]'")
        with temporary_folder() as sockets:
            links = links_of(options, sockets)
            links.write_logins()
            with open_bus(links.supervisor()) as bus, open_bus(links.client("supervisor")) as voice:
                folder, kept = _folder_of(sockets)
                if kept:
                    _prune(folder.parent, options.logs_max_mb)
                rows = process_table(options, model, links, folder if kept else None) if table is None else table
                return _Run(options, bus, voice, rows, policy, folder, model.where, kept).to_its_end()
    except BusError as error:
        print(f"fastslow: there is no bus: {error}; set TMPDIR to another folder", file=sys.stderr)
        return CONFIG
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            fix = "give the loopback device its address: ip address add 127.0.0.1/8 dev lo"
            print(f"fastslow: there is no {TCP_HOST} to listen on ({error.strerror}); {fix}", file=sys.stderr)
            return CONFIG
        fix = "run it in a folder of your own, and set FASTSLOW_DATA or TMPDIR to another one if need be"
        print(f"fastslow: cannot write {error.filename or 'a file'}: {error.strerror}; {fix}", file=sys.stderr)
        return CONFIG


def _taken(options: RunOptions) -> bool:
    """Whether somebody else has the door's port, who is then told of."""
    host, port = door_of(options).address
    if is_free(host, port):
        return False
    holder = listener_of(port) or "another process"
    other = "--listen" if options.listen else "--port (0: any free one)"
    print(f"fastslow: port {port} is held by {holder}; stop it, or choose another with {other}", file=sys.stderr)
    return True


def _try_to_write(path: Path) -> None:
    """Raises OSError where no recording can be written: told before the drive, not after it."""
    there = path.exists()
    path.open("ab").close()
    if not there:
        path.unlink()


def new_run_folder() -> Path:
    """`runs/<UTC time>-<pid>` under the current folder."""
    folder = Path("runs") / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _folder_of(temporary: Path) -> tuple[Path, bool]:
    """The run's folder, and whether it is kept: where none can be made, one that goes with the run."""
    try:
        folder = new_run_folder()
        _try_to_write(folder / SUPERVISOR)
        return folder, True
    except (FileExistsError, NotADirectoryError):  # no trouble of the disk, but something in the way
        raise
    except OSError as error:
        why = f"cannot write {error.filename or 'runs'}: {error.strerror}"
        print(f"fastslow: {why}; the run goes on without logs and recording", file=sys.stderr)
    folder = temporary / "run"
    folder.mkdir()
    return folder, False


def _prune(runs: Path, max_mb: float) -> None:
    """Make room for the logs of this run, and say so."""
    with contextlib.suppress(OSError):  # what cannot be removed stays
        if old := prune(runs, max_mb * 1e6):
            print(f"fastslow: the logs of {len(old)} old runs are removed (--logs-max-mb {max_mb:g})", file=sys.stderr)


class _Run:
    def __init__(
        self,
        options: RunOptions,
        bus: Bus,
        voice: Bus,
        table: tuple[Process, ...],
        policy: RestartPolicy | None,
        folder: Path,
        asked: str,
        kept: bool,
    ) -> None:
        """voice: another link to `bus`. asked: which language model, and whether words leave the machine for it.
        kept: whether the folder is.
        """
        self._options, self._bus = options, bus
        self._folder = folder
        self._log = open_log(self._folder)
        self._unkept = not kept
        self._out = sys.stderr if options.as_json else sys.stdout
        self._asked = asked
        self._supervisor = Supervisor(table, self._folder, self._notice, policy)
        self._hearing = Hearing(voice, self._notice, time.monotonic())
        self._live = Live()
        self._spoken_for_s = 0.0
        self._refused, self._refused_told_s = 0, 0.0
        self._shown: set[str] = set()
        self._opened_ns = time.monotonic_ns()
        self._began_ns: int | None = None
        self._summary = Summary(options.scenario, options.seed, self._opened_ns)
        self._said = options.say is None
        self._status = bus.subscribe(topics.STATUS)
        self._replies = bus.subscribe(topics.REPLY)
        self._events = bus.subscribe(topics.EVENT)
        self._actions = bus.subscribe(topics.ACTION)
        self._observations = bus.subscribe(topics.OBSERVATION)
        self._directives = bus.subscribe(topics.DIRECTIVE)
        self._commands = bus.subscribe_bytes(topics.COMMAND)

    def to_its_end(self) -> int:
        supervisor = self._supervisor
        self._print(
            f"fastslow: {self._options.scenario}, scheduling {trial(self._options.realtime)}, "
            f'{"no logs" if self._unkept else f"logs in {self._folder}/"}; speak to it with: fastslow say "..."'
            f"{speak_to(self._options)}"
        )
        if "slow" in supervisor.states:
            self._print(f"fastslow: the slow node asks {self._asked}")
        self._print(f"fastslow: {COLUMNS}")
        with catch_signals(supervisor.kill) as signals:
            try:
                code = None
                supervisor.start()
                next_line_s = time.monotonic() + 1.0
                while code is None and not signals.first:
                    time.sleep(STEP_S)
                    self._read_bus()
                    code = supervisor.step(self._hearing.hears(time.monotonic()))
                    self._begin_and_say()
                    self._speak_for_the_probed()
                    if code is None and self._overdue():
                        code = OK
                    if time.monotonic() >= next_line_s:
                        next_line_s += 1.0
                        rotate(self._folder)
                        self._print(self._live.line(time.monotonic_ns(), self._unready()))
                ended_ns = time.monotonic_ns()
            finally:
                supervisor.stop(self._read_bus)
            time.sleep(STEP_S)  # the last words may still be on their way
            self._read_bus()
            summary = self._finish(ended_ns)
            if code == OK and not signals.first and (why := self._stood(summary)):
                print(f"fastslow: {why}", file=sys.stderr)
                code = FAILED
            self._log.close()
            if signals.first:
                return 128 + signals.first
            return FAILED if code is None else code

    def _print(self, line: str) -> None:
        try:
            print(printable(line), file=self._out, flush=True)
        except OSError:  # nobody reads any more, or a full disk; the car drives on, and the run folder has it all
            self._out = open(os.devnull, "w")  # noqa: SIM115 - as long as the process

    def _notice(self, line: str) -> None:
        said = {"t_ns": time.monotonic_ns(), "node": "supervisor", "event": "notice", "detail": line}
        self._keep(SUPERVISOR, lambda: self._log.write(json.dumps(said).encode() + b"\n"))
        self._print(f"  {line}")

    def _keep(self, name: str, write: Callable[[], object]) -> None:
        """Write into the run folder, or say once that it cannot be written: the run goes on without."""
        try:
            write()
        except OSError as error:
            if not self._unkept:
                self._unkept = True
                self._print(f"  cannot write {self._folder / name}: {error.strerror}; the run goes on without logs")

    def _unready(self) -> str:
        return ", ".join(name for name, state in self._supervisor.states.items() if state in ("waiting", "starting"))

    def _read_bus(self) -> None:
        for status in self._status.take():
            self._supervisor.beat(status.node, status.pid)
            self._hearing.heard(status, time.monotonic())
            self._live.status(status)
            self._tell_where_shown(status)
            self._summary.status(status)
        for observation in self._observations.take():
            self._live.observation(observation)
            self._summary.observation(observation)
        for action in self._actions.take():
            self._live.action(action)
        for directive in self._directives.take():
            self._live.directive(directive)
        for payload in self._commands.take():
            self._hear(payload)
        for reply in self._replies.take():
            self._summary.reply(reply)
            self._print(self._live.reply(reply))
        for event in self._events.take():
            self._summary.event(event)
            line = self._live.event(event)
            if line is not None:
                self._print(line)
        self._tell_of_refusals()

    def _tell_of_refusals(self) -> None:
        """Once a second: that payloads could not be used, and why."""
        total, now_s = sum(self._bus.faults.values()), time.monotonic()
        if total != self._refused and now_s - self._refused_told_s >= 1.0:
            self._notice(f"{total - self._refused} payloads refused, the last on {self._bus.last_fault[:200]}")
            self._refused, self._refused_told_s = total, now_s

    def _tell_where_shown(self, status: Status) -> None:
        """Once each is there: where a browser finds the cockpit, and Foxglove the car."""
        shown = {"cockpit": "the car is shown at http://{}/", "foxglove": "Foxglove and Lichtblick connect to ws://{}"}
        if status.node in shown and status.node not in self._shown:
            self._shown.add(status.node)
            self._notice(shown[status.node].format(f"{TCP_HOST}:{status.metrics.get('port', 0):.0f}"))

    def _speak_for_the_probed(self) -> None:
        """Twice a second the heartbeat of those that speak no zenoh, so that everybody sees every process."""
        now_s = time.monotonic()
        if now_s - self._spoken_for_s < 0.5:
            return
        self._spoken_for_s = now_s
        for name, pid, state in self._supervisor.probed():
            self._bus.publish(
                topics.STATUS,
                Status(
                    epoch=0,
                    stamp_ns=time.monotonic_ns(),
                    node=name,
                    pid=pid,
                    seq=0,
                    state="ready" if state == "ready" else "degraded" if state == "gave up" else "starting",
                    detail="" if state in ("ready", "starting") else state,
                ),
            )

    def _hear(self, payload: bytes) -> None:
        """A command is told with its time; plain text has no id, and its replies alone tell of it."""
        try:
            command = decode_command(payload, fallback_id=PLAIN, epoch=0, now_ns=0)
        except Fault as fault:
            self._bus.faults["command"] = self._bus.faults.get("command", 0) + 1
            self._bus.last_fault = f"command: {fault}"
            return
        if command.id != PLAIN:
            self._summary.command(command)

    def _begin_and_say(self) -> None:
        """The run begins when the road is there and all who should listen do; the words of `--say` count from then."""
        now = time.monotonic_ns()
        if self._began_ns is None:
            states = self._supervisor.states
            drives = all(states.get(name, "ready") == "ready" for name in ("sim", "fast"))
            listens = states.get("slow", "ready") in ("ready", "gave up")
            if drives and (listens or now - self._opened_ns > START_WAIT_S * NS):
                self._began_ns = now
                self._summary.begin(now)
        elif not self._said and now - self._began_ns >= self._options.say_at_s * NS:
            self._said = True
            self._bus.publish(
                topics.COMMAND,
                Command(epoch=0, stamp_ns=now, id=secrets.randbits(48), text=self._options.say or "", source="run"),
            )

    def _overdue(self) -> bool:
        if self._options.duration_s is None or self._began_ns is None:
            return False
        allowed_s = self._options.duration_s + (OVERTIME_S if "sim" in self._supervisor.states else 0.0)
        return time.monotonic_ns() - self._began_ns > allowed_s * NS

    def _stood(self, summary: dict[str, object]) -> str:
        """Why a run that ended in time was no drive; "" where the car drove, or somebody else's simulator had it."""
        if "sim" not in self._supervisor.states:
            return ""
        if not summary["ticks"]:
            return f"the car drove no tick: the simulator was not ready; see {self._folder}/sim.jsonl"
        if "fast" in self._supervisor.states and not summary["answered"]:
            return f"the car was not driven: no tick was answered in time; see {self._folder}/fast.jsonl"
        return ""

    def _finish(self, ended_ns: int) -> dict[str, object]:
        """Write and tell the summary."""
        summary = self._summary.result(self._supervisor.restarts, ended_ns)
        summary["refused_payloads"] = dict(self._bus.faults)
        text = json.dumps(summary, indent=2) + "\n"
        self._keep(SUMMARY, lambda: (self._folder / SUMMARY).write_text(text, encoding="utf-8"))
        if self._options.as_json:
            print(json.dumps(summary), flush=True)
            return summary
        age, directives, delayed_by = summary["applied_age_us"], summary["directives"], summary["delayed_by"]
        assert isinstance(age, dict)
        assert isinstance(directives, dict)
        assert isinstance(delayed_by, dict)
        p50, p99 = (f"{value / 1e3:.1f}" if value is not None else "-" for value in (age["p50"], age["p99"]))
        self._print(
            f"summary: {summary['duration_s']} s, {summary['ticks']} ticks, {summary['answered']} answered, "
            f"{summary['missed']} missed, {summary['collisions']} collisions, "
            f"directives: {happened(directives, delayed_by)}; "
            f"{summary['restarts']} restarts, age of the applied action p50/p99 {p50}/{p99} ms; "
            f"{'no log was kept' if self._unkept else self._folder / SUMMARY}"
        )
        return summary
