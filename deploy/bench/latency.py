"""`fastslow bench latency`: the real processes at their real pace, beside bare transports, in one interleaved run."""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from typing import Any, Literal, cast

import msgspec
import numpy as np

from deploy.bench import figures
from deploy.bench.peers import PeerConfig, Transport, socket_of
from deploy.processes import Model, RunOptions, free_port, process_table, router_endpoints
from deploy.supervisor import Supervisor
from schemas import topics
from schemas.bus import BusConfig, ZenohBus, open_bus
from schemas.clock import NS
from schemas.codec import encode
from schemas.messages import Observation
from schemas.process import ConfigError
from schemas.realtime import Mode, resolve

Load = Literal["none", "cpu", "llm"]
LOADS: tuple[Load, ...] = ("none", "cpu", "llm")
PEERS: tuple[Transport, ...] = ("floor", "bus", "bus-default", "zmq", "dora")
HZ = 15
PERIOD_NS = NS // HZ
SETTLE_S = 2.0
"""Ticks before this are not counted: the load and the links come up."""
TURN = 200
"""Back to back, the contenders take turns of this many rounds."""
STARTS = 5
PARTS = ("bus out", "decode", "mask", "features", "policy", "rest of the step", "encode and put", "bus back")
INCLUDED = (
    "ours: from just before sim encodes and publishes an observation until sim has decoded the action that answers it, "
    "over the bus as deployed (supervisor's router, slow node, 5 Hz heartbeats). Back to back: a recorded observation "
    "is replayed to the real fast node, since the simulator's own step would lie between.",
    "floor: a Unix-socket ping-pong of the same payload sizes, plus one bare policy inference in a warm loop.",
    "bus, bus-default, zmq, dora: a ping-pong of the same payload sizes, with nothing done to the payloads.",
    "Paced, each contender has its own slice of the 66.7 ms. All have the same scheduling class. A round whose "
    "predecessor was late counts from when it was due; an unanswered or skipped tick counts as a miss.",
)


@dataclass(frozen=True, kw_only=True)
class Options:
    """What a user may choose. `seconds` is the paced time under each load."""

    seconds: float = 240.0
    loads: tuple[Load, ...] = LOADS
    realtime: Mode = "auto"
    peers: tuple[Transport, ...] = PEERS
    out: Path | None = None


@dataclass
class Samples:
    """Round trips in us, by what, load and pace, and what else was seen."""

    took: dict[tuple[str, str, str], list[float]] = field(default_factory=dict)
    skipped: dict[tuple[str, str, str], int] = field(default_factory=dict)
    parts: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    extra: dict[str, dict[str, object]] = field(default_factory=dict)

    def add(self, key: tuple[str, str, str], took_ns: Sequence[int], skipped: int = 0) -> None:
        self.took.setdefault(key, []).extend(t / 1000.0 for t in took_ns)
        self.skipped[key] = self.skipped.get(key, 0) + skipped


def say(line: str) -> None:
    """Progress, on stderr."""
    print(line, file=sys.stderr, flush=True)


def available(wanted: tuple[Transport, ...]) -> tuple[Transport, ...]:
    """The peers that can run here; says which cannot, and why."""
    packages = {"zmq": ("zmq",), "dora": ("dora", "pyarrow")}
    found: list[Transport] = []
    for peer in wanted:
        missing = [name for name in packages.get(peer, ()) if importlib.util.find_spec(name) is None]
        if peer == "dora" and not missing and not _dora_command():
            missing = ["the dora command (dora-rs-cli)"]
        if missing:
            say(f"bench: without {peer}: {', '.join(missing)} not installed; pip install 'fastslow[bench]'")
        else:
            found.append(peer)
    return tuple(found)


def _dora_command() -> str | None:
    return shutil.which("dora", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")


def _environment() -> dict[str, str]:
    env = {k: v for k, v in os.environ.items() if k != "ZENOH_RUNTIME"}  # our own choice, set by `open_bus`
    root = str(Path(__file__).resolve().parents[2])
    paths = [root, *env.get("PYTHONPATH", "").split(os.pathsep)]
    return {**env, "PYTHONPATH": os.pathsep.join(filter(None, paths)), "OPENBLAS_NUM_THREADS": "1"}


# --- what runs beside each other ---------------------------------------------------------------------------------


@contextmanager
def _processes(log: Path) -> Iterator[Any]:
    """Yields what starts a process that ends with the block; its output goes to `log`."""
    started: list[subprocess.Popen[bytes]] = []
    with log.open("ab") as file:

        def start(*argv: str, env: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
            started.append(subprocess.Popen(argv, stdin=subprocess.DEVNULL, stdout=file, stderr=file,
                                            env=env or _environment(), start_new_session=True))
            return started[-1]

        try:
            yield start
        finally:
            for process in started:
                process.terminate()
            for process in started:
                try:
                    process.wait(3.0)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()


class Deployment:
    """The system as `fastslow run` deploys it, without what `without` names."""

    def __init__(self, folder: Path, realtime: Mode, *without: str, trace: bool) -> None:
        self.sockets = Path(tempfile.mkdtemp(prefix="fastslow-"))
        self._port, llm = free_port(), free_port()
        self.model = Model(base_url=f"http://127.0.0.1:{llm}/v1", name="SmolLM2-135M-Instruct", embedded=True, port=llm)
        options = RunOptions(port=self._port, realtime=realtime, without=without, trace=folder if trace else None)
        self._notices: list[str] = []
        table = tuple(self._private(process) for process in process_table(options, self.model, self.sockets))
        self._supervisor = Supervisor(table, folder, self._notices.append)
        self._folder = folder
        self.bus: ZenohBus
        self.newest: Observation | None = None
        self.action_bytes = 0

    def _private(self, process: Any) -> Any:
        """The passenger's own memory is not touched by a benchmark."""
        argv = [*process.argv]
        if process.name == "slow":
            config = json.loads(argv[-1])
            argv[-1] = json.dumps({**config, "memory_path": str(self.sockets / "memory.sqlite")})
        return replace(process, argv=tuple(argv))

    def __enter__(self) -> Deployment:
        self._stack = ExitStack()
        self._stack.callback(shutil.rmtree, self.sockets, ignore_errors=True)
        self.bus = self._stack.enter_context(open_bus(BusConfig(
            mode="router", listen=router_endpoints(self.sockets, self._port))))
        self._status = self.bus.subscribe(topics.STATUS)
        self._observations = self.bus.subscribe(topics.OBSERVATION)
        self._actions = self.bus.subscribe_bytes(topics.ACTION)
        self._stack.callback(self._supervisor.stop, self._read)
        self._supervisor.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def _read(self) -> None:
        for status in self._status.take():
            self._supervisor.beat(status.node, status.pid)
        self.newest = next(iter(self._observations.take()), self.newest)
        for payload in self._actions.take():
            self.action_bytes = len(payload)

    def step(self) -> None:
        """Look after it, once. Raises `ConfigError` if a process is not what it should be."""
        self._read()
        code = self._supervisor.step()
        if code is not None or any(self._supervisor.restarts.values()) or "gave up" in self._supervisor.states.values():
            raise ConfigError(f"the system did not run through: {'; '.join(self._notices) or code}; "
                              f"see {self._folder}/*.jsonl")

    def ready(self, timeout_s: float = 60.0) -> None:
        """Look after it until all are ready."""
        deadline = time.monotonic() + timeout_s
        while any(state != "ready" for state in self._supervisor.states.values()):
            if time.monotonic() > deadline:
                raise ConfigError(f"the system did not start: {self._supervisor.states}; see {self._folder}/*.jsonl")
            self.step()
            time.sleep(0.02)

    def rss_mb(self, name: str) -> float | None:
        """Resident memory of a node (Linux)."""
        return rss_mb(self._supervisor.pid(name))


def rss_mb(pid: int | None) -> float | None:
    """Resident memory of a process in MB; None where /proc does not tell."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return None
    return round(int(status.partition("VmRSS:")[2].split()[0]) / 1000.0, 1)


class Peers:
    """The near ends, by transport, each with its connection for orders."""

    def __init__(self, folder: Path, peers: Sequence[Transport], sent: int, answered: int, realtime: Mode,
                 patience_s: float = 30.0) -> None:
        self._patience_s = patience_s
        self._folder, self._wanted, self._sizes, self._realtime = folder, tuple(peers), (sent, answered), realtime
        self.orders: dict[str, Connection] = {}
        self.scheduling: dict[str, str] = {}

    def __enter__(self) -> Peers:
        self._stack = ExitStack()
        sockets = tempfile.mkdtemp(prefix="fastslow-")
        self._stack.callback(shutil.rmtree, sockets, ignore_errors=True)
        listener = self._stack.enter_context(Listener(socket_of(sockets, "orders")))
        start = self._stack.enter_context(_processes(self._folder / "peers.log"))
        for transport in self._wanted:
            port = free_port()
            far, near = (json.dumps(msgspec.to_builtins(PeerConfig(
                transport=transport, near=near, folder=sockets, port=port, sent_bytes=self._sizes[0],
                answered_bytes=self._sizes[1], realtime=self._realtime))) for near in (False, True))
            if transport == "dora":
                self._start_dora(start, Path(sockets), far, near)
            else:
                for config in (far, near):
                    start(sys.executable, "-m", "deploy.bench.peers", config)
            self.meet(listener, transport)
        return self

    def join_ours(self, system: Deployment, seen: bytes) -> None:
        """Add the real fast node of `system`, with recorded observations sent to it in the simulator's place."""
        recorded = self._folder / "observation.bin"
        recorded.write_bytes(seen)
        listener = self._stack.enter_context(Listener(socket_of(str(system.sockets), "orders")))
        start = self._stack.enter_context(_processes(self._folder / "peers.log"))
        start(sys.executable, "-m", "deploy.bench.peers", json.dumps(msgspec.to_builtins(PeerConfig(
            transport="ours", near=True, folder=str(system.sockets), observation=str(recorded),
            realtime=self._realtime))))
        self.meet(listener, "ours")

    def __exit__(self, *error: object) -> None:
        for orders in self.orders.values():
            try:
                orders.send(None)
            except OSError:
                pass
        self._stack.close()

    def _start_dora(self, start: Any, folder: Path, far: str, near: str) -> None:
        def node(name: str, other: str, config: str) -> dict[str, object]:
            launcher = folder / f"{name}.py"
            launcher.write_text(
                "import sys\nsys.argv[1:] = [" + repr(config) + "]\nfrom deploy.bench import peers\n"
                "try:\n    peers.main()\nexcept (EOFError, KeyboardInterrupt):\n    pass\n", encoding="utf-8")
            return {"id": name, "path": str(launcher), "inputs": {"in": f"{other}/out"}, "outputs": ["out"]}

        flow = folder / "flow.yml"
        flow.write_text(json.dumps({"nodes": [node("near", "far", near), node("far", "near", far)]}), encoding="utf-8")
        env = _environment()
        env["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{env.get('PATH', '')}"
        start(_dora_command() or "dora", "run", str(flow), env=env)

    def meet(self, listener: Listener, transport: str) -> None:
        """Wait until a near end has come and is ready. Raises `ConfigError` if it does not."""
        met: list[Connection] = []
        thread = threading.Thread(target=lambda: met.append(listener.accept()), daemon=True)
        thread.start()
        thread.join(30.0)
        if not met or not met[0].poll(self._patience_s):
            raise ConfigError(f"{transport} did not come up; see {self._folder}/peers.log")
        name, scheduling = met[0].recv()
        if not met[0].poll(self._patience_s):
            raise ConfigError(f"{transport} did not answer; see {self._folder}/peers.log")
        met[0].recv()
        self.orders[name], self.scheduling[name] = met[0], scheduling


@contextmanager
def _load(load: Load, deployment: Deployment, folder: Path) -> Iterator[dict[str, object]]:
    """Keeps the machine busy for the time of the block; yields what was done, complete at its end."""
    did: dict[str, object] = {}
    with ExitStack() as stack:
        if load == "cpu":
            start = stack.enter_context(_processes(folder / "load.log"))
            cores = str(os.cpu_count() or 1)
            code = "import numpy as np\na = np.ones((1200, 1200), np.float32)\nwhile True: a @ a"
            start(sys.executable, "-c", code, env={**_environment(), "OPENBLAS_NUM_THREADS": cores})
            did["threads"] = int(cores)
        elif load == "llm":
            stop = threading.Event()
            asker = threading.Thread(target=_ask, args=(deployment.model, stop, did))
            asker.start()
            stack.callback(asker.join)
            stack.callback(stop.set)
        yield did


def _ask(model: Model, stop: threading.Event, did: dict[str, object]) -> None:
    import httpx

    answers = tokens = 0
    body = {"model": model.name, "max_tokens": 64,
            "messages": [{"role": "user", "content": "Tell me how to drive on a country road, in detail."}]}
    with httpx.Client(base_url=model.base_url, timeout=120.0, trust_env=False) as client:
        while not stop.is_set():
            try:
                reply = client.post("/chat/completions", json=body).raise_for_status().json()
                answers, tokens = answers + 1, tokens + int(reply["usage"]["completion_tokens"])
            except httpx.HTTPError as error:
                did["failure"] = str(error) or type(error).__name__
                stop.wait(1.0)
            did.update(answers=answers, tokens=tokens)


# --- measuring ---------------------------------------------------------------------------------------------------


def _paced(options: Options, load: Load, folder: Path, samples: Samples) -> tuple[int, int, bytes]:
    """The paced half of one load. Returns the sizes of an observation and an action, and an observation."""
    without = () if load == "llm" else ("llm",)
    n = round(options.seconds * HZ)
    with Deployment(folder, options.realtime, *without, trace=True) as system:
        system.ready()
        while system.newest is None or not system.action_bytes:
            system.step()
            time.sleep(0.02)
        seen = encode(system.newest)
        sizes = len(seen), system.action_bytes
        with Peers(folder, options.peers, *sizes, options.realtime) as peers, _load(load, system, folder) as did:
            settled = time.monotonic() + SETTLE_S
            while time.monotonic() < settled:
                system.step()
                time.sleep(0.02)
            first = _next_tick_ns(system) + PERIOD_NS * 3
            for i, orders in enumerate(peers.orders.values(), start=1):
                orders.send(("paced", first + i * PERIOD_NS // (len(peers.orders) + 1), PERIOD_NS, n))
            ends, said = first + n * PERIOD_NS, time.monotonic()
            while time.monotonic_ns() < ends:
                system.step()
                time.sleep(0.05)
                if time.monotonic() - said >= 10.0:
                    said = time.monotonic()
                    say(f"bench: load {load}: 15 Hz, {(time.monotonic_ns() - first) / NS:.0f} of {options.seconds:g} s")
            late: dict[str, list[int]] = {}
            for name, orders in peers.orders.items():
                took, late[name], inferred = orders.recv()
                samples.add((name, load, "15hz"), _with_inference(took, inferred))
            memory = {name: system.rss_mb(name) for name in ("sim", "fast")}
            scheduling = dict(peers.scheduling)
    _read_traces(folder, load, first, ends, samples)
    samples.extra[load].update(
        load=did, rss_mb=memory, scheduling=scheduling,
        timer_late_us={name: _p50_p99([t / 1000.0 for t in ns]) for name, ns in late.items() if ns})
    return *sizes, seen


def _with_inference(took: list[int], inferred: list[int]) -> list[int]:
    return [a + b for a, b in zip(took, inferred, strict=True)] if inferred else took


def _next_tick_ns(system: Deployment) -> int:
    before = system.newest
    while system.newest is before:
        system.step()
        time.sleep(0.002)
    assert system.newest is not None
    return system.newest.stamp_ns


def _read_traces(folder: Path, load: Load, first: int, ends: int, samples: Samples) -> None:
    """From the nodes' own stamps: the round trips, their parts and the ages of what was applied."""
    sim = np.fromfile(folder / "sim.trace", np.int64).reshape(-1, 6)
    fast = {(row[0], row[1]): row for row in np.fromfile(folder / "fast.trace", np.int64).reshape(-1, 9).tolist()}
    published = {(epoch, tick): at for epoch, tick, at, *_ in sim.tolist()}
    took: list[int] = []
    ages: list[float] = []
    skipped = 0
    parts: dict[str, list[float]] = {name: [] for name in PARTS}
    for epoch, tick, sent, answered, next_ns, applied in sim.tolist():
        if not first <= sent < ends:
            continue
        skipped += max(0, round((next_ns - sent) / PERIOD_NS) - 1)
        took.append(answered if answered >= 0 else max(PERIOD_NS, next_ns - sent))
        if (epoch, applied) in published:
            ages.append((next_ns - published[epoch, applied]) / 1000.0)
        row = fast.get((epoch, tick))
        if row is None or answered < 0:
            continue
        _, _, arrived, decoded, mask, features, policy, stepped, put = row
        for name, ns in zip(PARTS, (arrived - sent, decoded - arrived, mask, features, policy,
                                    stepped - decoded - mask - features - policy, put - stepped,
                                    sent + answered - put), strict=True):
            parts[name].append(ns / 1000.0)
    samples.add(("ours", load, "15hz"), took, skipped)
    samples.parts[load] = parts
    samples.extra[load] = {"applied_age_us": _p50_p99(ages), "skipped_ticks": skipped}


def _back_to_back(options: Options, load: Load, folder: Path, samples: Samples, sizes: tuple[int, int],
                  seen: bytes) -> None:
    """The back-to-back half of one load: the contenders take turns."""
    rounds = max(TURN, min(20_000, round(options.seconds * 50)) // TURN * TURN)
    without = ("sim", "slow") if load == "llm" else ("sim", "slow", "llm")
    with ExitStack() as stack:
        system = stack.enter_context(Deployment(folder, options.realtime, *without, trace=False))
        system.ready()
        peers = stack.enter_context(Peers(folder, options.peers, *sizes, options.realtime))
        peers.join_ours(system, seen)
        stack.enter_context(_load(load, system, folder))
        say(f"bench: load {load}: back to back, {rounds} rounds each")
        for _ in range(rounds // TURN):
            for name, orders in peers.orders.items():
                orders.send(("rounds", TURN))
                while not orders.poll(0.02):
                    system.step()
                took, _, inferred = orders.recv()
                samples.add((name, load, "back-to-back"), _with_inference(took, inferred))


def first_actions(folder: Path, seen: bytes) -> dict[str, object]:
    """Start the fast node again and again, alone: seconds from the process's start to its first action, and its RSS."""
    seconds: list[float] = []
    memory: float | None = None
    for _ in range(STARTS):
        sockets = Path(tempfile.mkdtemp(prefix="fastslow-"))
        near, fast = (f"unixsock-stream/{sockets / name}.sock" for name in ("near", "fast"))
        config = json.dumps({"bus": {"listen": [fast], "low_latency": True}})
        try:
            with (_processes(folder / "starts.log") as start,
                  open_bus(BusConfig(listen=(near,), connect=(fast,), low_latency=True)) as bus):
                actions = bus.subscribe_bytes(topics.ACTION)
                began = time.monotonic()
                process = start(sys.executable, "-m", "fast_node", config)
                while not actions.take():
                    if process.poll() is not None or time.monotonic() - began > 30.0:
                        raise ConfigError(f"the fast node gives no action; see {folder}/starts.log")
                    bus.publish_bytes(topics.OBSERVATION, seen)
                    time.sleep(0.002)
                seconds.append(time.monotonic() - began)
                memory = rss_mb(process.pid)
        finally:
            shutil.rmtree(sockets, ignore_errors=True)
    return {"first_action_s": round(float(np.median(seconds)), 3), "starts": STARTS, "rss_mb": memory}


# --- the result --------------------------------------------------------------------------------------------------


def _p50_p99(values: Sequence[float]) -> dict[str, float]:
    p50, p99 = (round(float(p), 1) for p in np.percentile(values, (50, 99))) if len(values) else (0.0, 0.0)
    return {"p50": p50, "p99": p99}


def host(realtime: Mode) -> dict[str, object]:
    """What the figures depend on."""
    versions: dict[str, str | None] = {"python": platform.python_version()}
    for name in ("fastslow", "eclipse-zenoh", "numpy", "msgspec", "pyzmq", "dora-rs"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    return {
        "cpu": _cpu(), "cores": os.cpu_count(), "kernel": f"{platform.system()} {platform.release()}",
        "load_average": [round(x, 2) for x in os.getloadavg()], "realtime": resolve(realtime), "versions": versions}


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def targets(rows: Sequence[figures.Row], fast: dict[str, object], realtime: Mode) -> list[dict[str, object]]:
    """The figures that were promised, those of them that this run has."""
    by = {(row.what, row.load, row.pace): row for row in rows}
    found: list[dict[str, object]] = []

    def check(figure: str, value: float | None, limit: float, *, at_least: bool = False) -> None:
        if value is not None:
            reached = value >= limit if at_least else value <= limit
            found.append({"figure": figure, "value": round(value, 3), "limit": limit, "reached": reached})

    ours, floor = by.get(("ours", "none", "15hz")), by.get(("floor", "none", "15hz"))
    if ours is not None:
        if floor is not None:
            check("paced p50, ours / floor", ours.p50_us / floor.p50_us, 1.5)
            check("paced p99, ours / floor", ours.p99_us / floor.p99_us, 1.5)
        check("paced p99, ours [ms]", ours.p99_us / 1000.0, 1.2)
        for load in ("cpu", "llm"):
            loaded = by.get(("ours", load, "15hz"))
            if loaded is not None:
                limit = 1.25 if resolve(realtime) == "fifo" else 2.0
                check(f"paced p99, load {load} / none", loaded.p99_us / ours.p99_us, limit)
                check(f"missed deadlines, load {load}", float(loaded.misses), 0.0)
        for pace in ("15hz", "back-to-back"):
            dora = by.get(("dora", "none", pace))
            for what in ("bus", "ours"):
                mine = by.get((what, "none", pace))
                if dora is not None and mine is not None:
                    check(f"p50 {pace}, dora / {what}", dora.p50_us / mine.p50_us, 4.0, at_least=True)
    check("fast node, start to first action [s]", cast("float | None", fast["first_action_s"]), 0.5)
    check("fast node, resident memory [MB]", cast("float | None", fast["rss_mb"]), 100.0)
    return found


def run(options: Options) -> tuple[dict[str, Any], Path]:
    """Measure, save and return the result and where it is. Raises `ConfigError` if something needed is missing."""
    folder = options.out or Path("runs") / f"bench-{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}"
    folder.mkdir(parents=True, exist_ok=True)
    options = replace(options, peers=available(options.peers))
    if options.seconds * HZ < figures.TICKS_FOR_P999:
        say(f"bench: {options.seconds:g} s are {options.seconds * HZ:.0f} ticks: too few for p99.9, which needs "
            f"{figures.TICKS_FOR_P999} ({figures.TICKS_FOR_P999 / HZ:.0f} s)")
    machine, samples = host(options.realtime), Samples()
    fast: dict[str, object] = {}
    for load in options.loads:
        say(f"bench: load {load}: 15 Hz, {options.seconds:g} s")
        sent, answered, seen = _paced(options, load, folder, samples)
        if not fast:
            fast = first_actions(folder, seen)
        _back_to_back(options, load, folder, samples, (sent, answered), seen)
    rows = [figures.row_of(*key, took, samples.skipped[key]) for key, took in sorted(
        samples.took.items(), key=lambda item: (LOADS.index(cast(Load, item[0][1])), item[0][2], item[0][0]))]
    result: dict[str, Any] = {
        "schema": figures.SCHEMA,
        "host": {**machine, "payload_bytes": {"observation": sent, "action": answered}},
        "rows": [msgspec.to_builtins(row) for row in rows],
        "parts_us": {load: {name: _p50_p99(values) for name, values in parts.items()}
                     for load, parts in samples.parts.items()},
        "loads": samples.extra,
        "fast_node": fast,
        "targets": targets(rows, fast, options.realtime),
        "included": INCLUDED,
        "histograms": {"/".join(key): figures.histogram(took) for key, took in samples.took.items()},
    }
    path = folder / "latency.json"
    path.write_text(json.dumps(result) + "\n", encoding="utf-8")
    return result, path


def lines(result: dict[str, Any]) -> Iterator[str]:
    """The result for people."""
    machine = result["host"]
    yield (f"{machine['cpu']}, {machine['cores']} cores, {machine['kernel']}, scheduling: {machine['realtime']}, "
           f"load average {machine['load_average'][0]:g} at the start")
    yield ", ".join(f"{name} {number}" for name, number in machine["versions"].items() if number)
    yield from figures.table(result["rows"], result["histograms"])
    for load, parts in result["parts_us"].items():
        yield f"parts of ours, load {load}, p50/p99 us: " + ", ".join(
            f"{name} {p['p50']:.0f}/{p['p99']:.0f}" for name, p in parts.items())
        yield f"  age of the observation that each applied action answers, p50/p99 us: " \
              f"{result['loads'][load]['applied_age_us']['p50']:.0f}/{result['loads'][load]['applied_age_us']['p99']:.0f}"
    for target in result["targets"]:
        yield f"{'reached' if target['reached'] else 'MISSED ':<8} {target['figure']}: {target['value']:g} " \
              f"(limit {target['limit']:g})"
    for text in result["included"]:
        yield f"included: {text}"
