"""The supervisor with tiny fake nodes, and the command line as a user calls it."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from deploy.run.logs import SUMMARY, SUPERVISOR
from deploy.run.processes import Model, Process, RunOptions, free_port, links_of, listener_of, process_table
from deploy.run.status import COLUMNS, Live
from deploy.run.summary import Summary
from deploy.run.supervisor import RestartPolicy, Supervisor
from deploy.run.system import run_system
from schemas.runtime.process import CONFIG, load_config
from schemas.wire.messages import Command, Directive, Event, EventKind, Observation, Reason, Reply, Status
from sim_node.config import SimConfig
from tests.waiting import until

QUICK = RestartPolicy(first_s=0.05, most_s=0.1, grace_s=0.5)
ROOT = Path(__file__).parents[3]

SLEEPER = "import time\nwhile True: time.sleep(1)"
STUBBORN = f"import signal\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n{SLEEPER}"
WITH_CHILD = f"import subprocess, sys\nsubprocess.Popen([sys.executable, '-c', {STUBBORN!r}])\n{SLEEPER}"
FAILING = 'import sys\nprint(\'{"event": "x", "detail": "no road"}\', file=sys.stderr)\nsys.exit(3)'


def fake(name: str, code: str, *, critical: bool = False, **more: object) -> Process:
    return Process(name=name, argv=(sys.executable, "-c", code), critical=critical, **more)  # type: ignore[arg-type]


class Watched:
    """A supervisor under test, with everything that it said; `hearts` are the nodes whose hearts beat."""

    def __init__(self, folder: Path, *table: Process) -> None:
        self.said: list[str] = []
        self.hearts = {process.name for process in table}
        self.supervisor = Supervisor(table, folder, self.said.append, QUICK)
        self.code: int | None = None

    def until(self, condition: Callable[[], bool]) -> None:
        def beaten() -> bool:
            if condition():
                return True
            for name in self.hearts:
                pid = self.supervisor.pid(name)
                if pid is not None:
                    self.supervisor.beat(name, pid)
            self.code = self.supervisor.step()
            return False

        until(beaten, f"it did not happen: {self.said}")

    def ready(self, name: str) -> bool:
        return self.supervisor.states[name] == "ready"


@pytest.fixture
def watch(tmp_path: Path) -> Iterator[Callable[..., Watched]]:
    made: list[Watched] = []

    def start(*table: Process) -> Watched:
        made.append(Watched(tmp_path, *table))
        made[-1].supervisor.start()
        return made[-1]

    yield start
    for watched in made:
        watched.supervisor.stop()


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def group(pid: int) -> list[int]:
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if os.getpgid(int(folder.name)) == pid and alive(int(folder.name)):
                found.append(int(folder.name))
        except ProcessLookupError:
            continue
    return found


def test_a_killed_process_comes_back_and_is_counted(watch: Callable[..., Watched]) -> None:
    watched = watch(fake("slow", SLEEPER), fake("sim", SLEEPER, critical=True))
    watched.until(lambda: watched.ready("slow") and watched.ready("sim"))
    sim, slow = watched.supervisor.pid("sim"), watched.supervisor.pid("slow")
    assert slow is not None
    os.kill(slow, signal.SIGKILL)
    watched.until(lambda: watched.supervisor.restarts["slow"] == 1 and watched.ready("slow"))
    assert watched.supervisor.pid("slow") != slow
    assert watched.supervisor.pid("sim") == sim
    assert any("killed by signal 9" in line for line in watched.said)
    assert "slow is back" in watched.said


def test_a_process_whose_heart_stops_is_killed_and_restarted(watch: Callable[..., Watched]) -> None:
    watched = watch(fake("fast", STUBBORN, heartbeat_s=0.3))
    watched.until(lambda: watched.ready("fast"))
    first = watched.supervisor.pid("fast")
    assert first is not None
    watched.hearts.clear()
    watched.until(lambda: watched.supervisor.restarts["fast"] == 1)
    assert not alive(first)
    watched.until(lambda: watched.supervisor.pid("fast") not in (None, first))
    watched.supervisor.beat("fast", first)  # a heartbeat that the dead one had sent
    assert not watched.ready("fast")


def test_nobody_is_killed_for_silence_while_the_supervisor_is_deaf(
    watch: Callable[..., Watched], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0
    monkeypatch.setattr("deploy.run.supervisor.time", SimpleNamespace(monotonic=lambda: now_s))
    watched = watch(fake("fast", SLEEPER, heartbeat_s=0.25))
    watched.until(lambda: watched.ready("fast"))
    for hears, restarts in [(False, 0)] * 10 + [(True, 0)] * 2 + [(True, 1)]:
        now_s += 0.125
        watched.supervisor.step(hears)
        assert watched.supervisor.restarts["fast"] == restarts


def test_the_run_ends_when_what_drives_keeps_failing(watch: Callable[..., Watched]) -> None:
    watched = watch(fake("sim", FAILING, critical=True))
    watched.until(lambda: watched.code is not None)
    assert watched.code == 1
    assert watched.supervisor.restarts["sim"] == 5
    assert "no road" in watched.said[-1]


def test_the_run_goes_on_when_what_thinks_keeps_failing(watch: Callable[..., Watched]) -> None:
    watched = watch(fake("slow", FAILING), fake("sim", SLEEPER, critical=True))
    watched.until(lambda: watched.supervisor.states["slow"] == "gave up")
    assert watched.code is None
    assert watched.ready("sim")
    assert "going on without it" in watched.said[-1]


def test_a_bad_configuration_is_not_tried_again(watch: Callable[..., Watched]) -> None:
    words = 'import sys\nprint(\'{"detail": "unknown scenario"}\', file=sys.stderr)\nsys.exit(78)'
    watched = watch(fake("sim", words, critical=True))
    watched.until(lambda: watched.code is not None)
    assert watched.code == 78
    assert watched.said == ["sim cannot start: unknown scenario"]


def test_the_end_of_the_road_is_the_end_of_the_run(watch: Callable[..., Watched]) -> None:
    watched = watch(fake("sim", "pass", critical=True, finishes=True), fake("fast", SLEEPER, critical=True))
    watched.until(lambda: watched.code is not None)
    assert watched.code == 0


def test_a_process_waits_for_what_it_needs(watch: Callable[..., Watched]) -> None:
    watched = watch(fake("fast", SLEEPER), fake("sim", SLEEPER, needs=("fast",)))
    assert watched.supervisor.pid("sim") is None
    watched.until(lambda: watched.ready("sim"))


def test_who_is_critical_is_waited_for_and_who_only_records_is_not(
    watch: Callable[..., Watched], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deploy.run.supervisor.NEEDS_WAIT_S", 0.0)
    fast, sim = fake("fast", SLEEPER, critical=True), fake("sim", SLEEPER, needs=("fast", "record"))
    watched = watch(fast, fake("record", SLEEPER), sim)
    watched.hearts = {"sim"}
    watched.supervisor.step()
    assert watched.supervisor.pid("sim") is None
    watched.hearts.add("fast")
    watched.until(lambda: watched.ready("sim"))
    assert not watched.ready("record")


def test_the_model_server_is_ready_when_it_answers(watch: Callable[..., Watched]) -> None:
    port = free_port()
    server = f"import http.server as h\nh.HTTPServer(('127.0.0.1', {port}), h.SimpleHTTPRequestHandler).serve_forever()"
    watched = watch(fake("llm", server, probe_url=f"http://127.0.0.1:{port}/"))
    watched.hearts.clear()
    watched.until(lambda: watched.ready("llm"))


def test_nothing_is_left_after_a_stop(watch: Callable[..., Watched]) -> None:
    watched = watch(fake("slow", STUBBORN), fake("sim", WITH_CHILD))
    watched.until(lambda: watched.ready("slow") and watched.ready("sim"))
    slow, sim = watched.supervisor.pid("slow"), watched.supervisor.pid("sim")
    assert slow is not None
    assert sim is not None
    watched.until(lambda: len(group(sim)) == 2)
    watched.supervisor.stop()
    watched.until(lambda: group(slow) == group(sim) == [])  # the kernel ends a group in its own time


def test_backoff_doubles_up_to_its_limit() -> None:
    policy = RestartPolicy(jitter=0.0)
    assert [policy.delay_s(n) for n in range(1, 7)] == [0.5, 1.0, 2.0, 4.0, 8.0, 8.0]


def test_a_run_that_begins_removes_the_logs_of_old_ones_beyond_their_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FASTSLOW_DATA", str(tmp_path / "data"))
    folders = [tmp_path / "runs" / f"2026112{k}T120000Z-1" for k in range(3)]
    for folder in folders:
        folder.mkdir(parents=True)
        (folder / SUPERVISOR).write_bytes(b"x" * 600_000)
    table = (fake("sim", "pass", critical=True, finishes=True),)
    run_system(RunOptions(port=0, as_json=True, logs_max_mb=1.0), table, QUICK)
    assert "the logs of 2 old runs are removed (--logs-max-mb 1)" in capsys.readouterr().err
    mine, *old = sorted((tmp_path / "runs").iterdir(), key=lambda folder: folder in folders)
    assert (old, (mine / SUMMARY).exists()) == (folders[2:], True)


RUN = """
import sys
from deploy.run.processes import Process, RunOptions
from deploy.run.system import run_system
from deploy.run.supervisor import RestartPolicy
stubborn = {stubborn!r}
table = tuple(Process(name=n, argv=(sys.executable, "-c", stubborn), critical=False) for n in ("sim", "fast", "slow"))
sys.exit(run_system(RunOptions(port=0, as_json=True), table, RestartPolicy(grace_s={grace_s})))
"""


def start_run(folder: Path, grace_s: float) -> tuple[subprocess.Popen[bytes], list[int]]:
    """A run, and its three processes, which note in `asked` that they should end, and do not."""
    note = f"import signal\nsignal.signal(signal.SIGTERM, lambda *_: open({str(folder / 'asked')!r}, 'w').close())"
    up = f"import os\nopen({str(folder)!r} + f'/up-{{os.getpid()}}', 'w').close()"
    code = RUN.format(stubborn=f"{note}\n{up}\n{SLEEPER}", grace_s=grace_s)
    env = {**os.environ, "PYTHONPATH": str(ROOT), "FASTSLOW_DATA": str(folder)}
    run = subprocess.Popen(
        [sys.executable, "-c", code], cwd=folder, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    until(lambda: len(list(folder.glob("up-*"))) == 3, "the processes did not come up")
    return run, [int(file.name.removeprefix("up-")) for file in folder.glob("up-*")]


def test_a_terminated_run_leaves_a_summary_and_no_orphan(tmp_path: Path) -> None:
    run, pids = start_run(tmp_path, grace_s=0.2)
    run.send_signal(signal.SIGTERM)
    out, _ = run.communicate(timeout=60)
    assert run.returncode == 143
    assert not any(map(alive, pids))
    summary = json.loads(out)
    assert summary["schema"] == "fastslow.run/3"
    assert {"ticks", "answered", "missed", "collisions", "restarts", "latency_us", "commands", "directives"} <= set(
        summary
    )
    assert [json.loads(file.read_text()) for file in tmp_path.glob("runs/*/summary.json")] == [summary]


def test_a_second_signal_ends_it_at_once(tmp_path: Path) -> None:
    run, pids = start_run(tmp_path, grace_s=1000.0)
    run.send_signal(signal.SIGINT)
    until((tmp_path / "asked").exists, "nobody was asked to end")
    run.send_signal(signal.SIGINT)
    out, _ = run.communicate(timeout=60)
    assert (run.returncode, out) == (130, b"")
    until(lambda: not any(map(alive, pids)), "a process outlived the run")


def fastslow(*words: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "PYTHONPATH": str(ROOT), **({"FASTSLOW_DATA": str(folder)} if folder else {})}
    return subprocess.run(
        [sys.executable, "-m", "deploy", *words],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=folder,
        env=env,
        check=False,
    )


def test_a_taken_port_names_its_holder(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        result = fastslow("run", "--port", str(port), folder=tmp_path)
        assert listener_of(port) is not None
    assert result.returncode == 75
    assert f"port {port} is held by process {os.getpid()} (" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("verb", [("say", "faster, please"), ("status",)])
def test_nobody_there_is_69(verb: tuple[str, ...]) -> None:
    result = fastslow(*verb, "--port", str(free_port()))
    assert result.returncode == 69
    assert "nobody is there" in result.stderr
    assert "fastslow run" in result.stderr


def test_a_file_in_the_place_of_the_runs_folder_is_78(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("a file where the folder should be")
    result = fastslow("run", "--port", "0", folder=tmp_path)
    assert result.returncode == 78
    assert "Traceback" not in result.stderr
    assert "cannot write" in result.stderr


def test_a_usage_mistake_is_2() -> None:
    assert fastslow("run", "--without", "wheels").returncode == 2
    assert fastslow("run", "--duration", "soon").returncode == 2
    assert fastslow("fly").returncode == 2


@pytest.mark.parametrize("verb", [(), ("run",), ("say",), ("status",), ("doctor",)])
def test_help_shows_examples_and_exit_codes(verb: tuple[str, ...]) -> None:
    result = fastslow(*verb, "--help")
    assert result.returncode == 0
    assert "Examples:" in result.stdout
    assert " ".join(("fastslow", *verb)) in result.stdout
    assert "Exit codes" in result.stdout


def test_help_loads_nothing_heavy() -> None:
    code = textwrap.dedent("""
        import sys, deploy.cli.app
        heavy = {"zenoh", "numpy", "httpx", "msgspec", "gymnasium", "torch"} & set(sys.modules)
        sys.exit(" ".join(heavy) or 0)
    """)
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


def test_doctor_reports_in_json() -> None:
    report = json.loads(fastslow("doctor", "--json", "--port", str(free_port())).stdout)
    assert report["schema"] == "fastslow.doctor/1"
    found = {check["name"]: check["result"] for check in report["checks"]}
    assert found["bus"] == found["packages"] == found["port"] == "ok"
    assert all(check["fix"] for check in report["checks"] if check["result"] != "ok")


def test_the_table_says_who_matters() -> None:
    model = Model(base_url="http://127.0.0.1:1/v1", name="x", embedded=True, port=1)
    options = RunOptions(duration_s=4.0)
    table = {p.name: p for p in process_table(options, model, links_of(options, Path("/tmp/s")))}
    assert [p.name for p in table.values() if p.critical] == ["fast", "sim"]
    config = json.loads(table["sim"].argv[-1])
    assert (config["scenario"], config["duration_s"]) == ("two-way-natural", 4.0)
    assert "unixsock-stream//tmp/s/bus.sock" in config["bus"]["connect"]
    cloud = Model(base_url="https://x/v1", name="x", embedded=False)
    options = RunOptions(without=("fast",))
    names = [p.name for p in process_table(options, cloud, links_of(options, Path("/tmp/s")))]
    assert names == ["door", "sim", "slow"]


def test_the_simulator_is_told_the_text_of_a_scenario_file(tmp_path: Path) -> None:
    road = tmp_path / "mine.toml"
    road.write_text('base = "merge"\nduration_s = 9\n', encoding="utf-8")
    options, nobody = RunOptions(scenario=str(road), traffic=("sway",)), Model(base_url="", name="", embedded=False)
    [argv] = [p.argv for p in process_table(options, nobody, links_of(options, tmp_path)) if p.name == "sim"]
    told = load_config(SimConfig, [argv[-1]])
    assert (told.road().name, told.road().duration_s, told.road().manners.sway_m) == ("mine", 9.0, 0.3)


def test_the_summary_tells_each_command_with_its_times() -> None:
    summary = Summary("two-way", 3, 0)
    second = 10**9
    common = {"epoch": 1, "command_id": 5, "text": "faster"}
    summary.command(Command(epoch=0, stamp_ns=second, id=5, text="faster"))
    for at, outcome in ((2, "heard"), (3, "issued"), (4, "issued"), (9, "fulfilled")):
        summary.reply(Reply(stamp_ns=at * second, outcome=outcome, **common))  # type: ignore[arg-type]
    for kind in (EventKind.DELAYED, EventKind.DELAYED, EventKind.OVERRIDDEN):
        summary.event(Event(epoch=1, stamp_ns=0, kind=kind, node="fast", tick=1, reason=Reason.ONCOMING))
    for pid in (1, 2):
        summary.status(
            Status(
                epoch=1,
                stamp_ns=0,
                node="sim",
                pid=pid,
                seq=1,
                state="ready",
                metrics={"ticks": 10.0 * pid, "answered": 9.0, "rtt_p50_us": 100.0 * pid},
            )
        )
    result = summary.result({"sim": 1, "slow": 0}, 20 * second)
    assert (result["ticks"], result["answered"], result["restarts"]) == (30, 18, 1)
    assert (result["directives"], result["delayed_by"]) == (
        {"delayed": 2, "overridden": 1, "carried_out": 0, "fulfilled": 0, "expired": 0},
        {"oncoming traffic": 2},
    )
    assert result["latency_us"] == {"p50": 200.0, "p99": None}
    assert result["commands"] == [
        {
            "text": "faster",
            "said_s": 1.0,
            "heard_s": 2.0,
            "issued_s": 3.0,
            "outcome": "fulfilled",
            "fulfilled_s": 9.0,
            "why": "",
        }
    ]


def test_the_live_line_shows_what_is_going_on() -> None:
    live = Live()
    assert live.line(0, "sim") == "starting: waiting for sim"
    live.observation(Observation(epoch=1, stamp_ns=0, tick=30, scenario="two-way", lanes=(), rows=b""))
    live.directive(Directive(epoch=1, stamp_ns=0, id=9, command_id=5, scene_tick=1, manoeuvre="overtake"))
    assert "overtake, 28 s left" in live.line(2 * 10**9)
    assert len(live.line(0).split(" | ")) == len(COLUMNS.split(" | ")) - 1  # nobody has told how it is driven yet
    reply = Reply(epoch=1, stamp_ns=0, command_id=5, outcome="fulfilled", text="faster", say="Done.", directive_id=9)
    assert 'fulfilled   "faster": "Done."' in live.reply(reply)
    assert "no directive" in live.line(2 * 10**9)
    assert live.event(Event(epoch=1, stamp_ns=0, kind=EventKind.FULFILLED, node="fast", tick=1, command_id=5)) is None
    begun = Event(
        epoch=1,
        stamp_ns=0,
        kind=EventKind.CARRIED_OUT,
        node="fast",
        tick=8,
        reason=Reason.ONCOMING,
        vehicle=4,
        duration_s=1.5,
    )
    assert "carried out tick 8, oncoming traffic, vehicle 4, for 1.5 s" in (live.event(begun) or "")


@pytest.mark.parametrize("mistake", ["model", "recording", "scenario"])
def test_a_mistake_about_files_ends_the_start_with_one_line_and_without_a_run_folder(
    mistake: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FASTSLOW_DATA", str(tmp_path / "data"))
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    monkeypatch.setenv("FASTSLOW_GGUF", "/no/such.gguf" if mistake == "model" else "")
    record = Path("/no/such/x.mcap") if mistake == "recording" else None
    road = "/no/such.toml" if mistake == "scenario" else "highway"
    assert run_system(RunOptions(scenario=road, port=0, record=record)) == CONFIG
    said = capsys.readouterr().err
    assert (said.count("\n"), "/no/such" in said, (tmp_path / "runs").exists()) == (1, True, False)
