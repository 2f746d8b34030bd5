"""What the benchmarks run beside each other: the deployed system, both ends of ping-pongs, and loads.

Any of them may die or never come up. That ends neither the benchmark nor the others: `Lost` says why in one line.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from deploy.bench.peers import PeerConfig, Transport, socket_of
from deploy.run.processes import Model, Process, RunOptions, free_port, process_table, router_endpoints
from deploy.run.supervisor import Supervisor
from schemas.runtime.bus import BusConfig, ZenohBus, open_bus
from schemas.runtime.realtime import Mode
from schemas.wire import topics
from schemas.wire.messages import Observation

Load = Literal["none", "cpu", "llm"]
LOADS: tuple[Load, ...] = ("none", "cpu", "llm")
START_S = 60.0
"""For the whole system to be ready."""
PATIENCE_S = 20.0
"""A peer that is silent for longer hangs."""
GRACE_S = 3.0
"""From SIGTERM to SIGKILL."""
HOG = """
import numpy as np
from schemas.runtime.process import die_with_parent
die_with_parent()
a = np.ones((1200, 1200), np.float32)
while True: a @ a
"""


class Lost(Exception):  # noqa: N818 - what has become of a contender, not a mistake of ours
    """A contender, or what it needs, did not come up or died; `str()` says what and why in one line."""


def say(line: str) -> None:
    """Progress, on stderr."""
    print(line, file=sys.stderr, flush=True)


def environment() -> dict[str, str]:
    """For our own processes, wherever the benchmark was started."""
    env = {k: v for k, v in os.environ.items() if k != "ZENOH_RUNTIME"}  # our own choice, set by `open_bus`
    root = str(Path(__file__).resolve().parents[2])
    paths = [root, *env.get("PYTHONPATH", "").split(os.pathsep)]
    return {**env, "PYTHONPATH": os.pathsep.join(filter(None, paths)), "OPENBLAS_NUM_THREADS": "1"}


def dora_command() -> str | None:
    """Where dora-rs-cli is, if anywhere."""
    return shutil.which("dora", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")


def trace_of(path: Path) -> NDArray[np.int64]:
    """What a node kept of its ticks, (T, 9): see `RoundTrips` and the fast node's loop. Raises `Lost` without it."""
    try:
        return np.fromfile(path, np.int64).reshape(-1, 9)
    except OSError:
        raise Lost(f"no stamps in {path}: its node did not end in time") from None


def rss_mb(pid: int | None) -> float | None:
    """Resident memory of a process in MB; None where /proc does not tell."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return None
    return round(int(status.partition("VmRSS:")[2].split()[0]) * 1.024e-3, 1)


@dataclass(frozen=True)
class Child:
    """A process of the benchmark, leader of its own group, and the file that it writes to."""

    name: str
    popen: subprocess.Popen[bytes]
    log: Path

    def trouble(self) -> str:
        """How it ended, with its last line; empty while it runs."""
        code = self.popen.poll()
        if code is None:
            return ""
        how = f"ended with code {code}" if code >= 0 else f"was killed by signal {-code}"
        return f"its {self.name} {how}{self.last_line()}"

    def last_line(self) -> str:
        """`: ` and the last line it wrote, or nothing."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return f": {lines[-1].strip()[:200]}" if lines else ""


def _trouble(parts: Sequence[Child]) -> str:
    """What is wrong with an end of a ping-pong. One that ends with code 0 only follows the other, which says more."""
    ended = [part for part in parts if part.popen.poll() is not None]
    failed = [part for part in ended if part.popen.returncode]
    if failed or len(ended) == len(parts):
        return (failed or ended)[0].trouble()
    return ""


Start = Callable[..., Child]


@contextmanager
def children() -> Iterator[Start]:
    """Yields `start(name, log, *argv, env=None)`; what it starts ends with the block, with all that it started."""
    started: list[Child] = []

    def start(name: str, log: Path, *argv: str, env: dict[str, str] | None = None) -> Child:
        with log.open("wb") as file:
            started.append(
                Child(
                    name,
                    subprocess.Popen(
                        argv,
                        stdin=subprocess.DEVNULL,
                        stdout=file,
                        stderr=file,
                        env=env or environment(),
                        start_new_session=True,
                    ),
                    log,
                )
            )
        return started[-1]

    try:
        yield start
    finally:
        for child in started:
            _signal(child, signal.SIGTERM)
        until = time.monotonic() + GRACE_S
        for child in started:
            try:
                child.popen.wait(max(0.0, until - time.monotonic()))
            except subprocess.TimeoutExpired:
                pass
            _signal(child, signal.SIGKILL)
            child.popen.wait()


def _signal(child: Child, number: int) -> None:
    try:
        os.killpg(child.popen.pid, number)
    except (ProcessLookupError, PermissionError):  # macOS says the latter of a group of zombies
        pass


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
        with ExitStack() as stack:
            stack.callback(shutil.rmtree, self.sockets, ignore_errors=True)
            self.bus = stack.enter_context(
                open_bus(BusConfig(mode="router", listen=router_endpoints(self.sockets, self._port)))
            )
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
        """Look after it until this is met. Raises `Lost` if one of its processes dies, or it takes too long."""
        deadline = time.monotonic() + START_S
        while not met():
            self.step()
            if self.lost:
                raise Lost(self.lost)
            if time.monotonic() > deadline:
                raise Lost(f"{what} took longer than {START_S:g} s: {self._supervisor.states}")
            time.sleep(0.002)

    def ready(self) -> None:
        """Look after it until all are ready. Raises `Lost`."""
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


@dataclass
class _Peer:
    orders: Connection
    parts: Sequence[Child]
    trouble: Callable[[], str]

    def wait(self, patience_s: float, meanwhile: Callable[[], None]) -> Any:
        """The next thing that the near end says. Raises `Lost`."""
        deadline = time.monotonic() + patience_s
        while not self.orders.poll(0.02):
            meanwhile()
            self.check()
            if time.monotonic() > deadline:
                raise Lost(f"it did not answer for {patience_s:g} s{self.parts[-1].last_line()}")
        try:
            return self.orders.recv()
        except (EOFError, OSError):
            until = time.monotonic() + 1.0
            while time.monotonic() < until:  # the connection ends before the process does
                self.check()
                time.sleep(0.01)
            raise Lost(f"its near end closed the connection{self.parts[-1].last_line()}") from None

    def check(self) -> None:
        """Raises `Lost` if one of its processes has ended."""
        why = self.trouble() or _trouble(self.parts)
        if why:
            raise Lost(why)


class Peers:
    """Contenders, by transport, that take orders. One that does not start, dies or hangs is dropped, and `lost` says
    why; the others go on."""

    def __init__(
        self,
        folder: Path,
        peers: Sequence[Transport],
        sent: int,
        answered: int,
        realtime: Mode,
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._folder, self._wanted, self._sizes, self._realtime = folder, tuple(peers), (sent, answered), realtime
        self._patience_s = patience_s
        self._live: dict[str, _Peer] = {}
        self.scheduling: dict[str, str] = {}
        self.lost: dict[str, str] = {}

    def __enter__(self) -> Peers:
        with ExitStack() as stack:
            self._stack = stack
            self._sockets = Path(tempfile.mkdtemp(prefix="fastslow-"))
            stack.callback(shutil.rmtree, self._sockets, ignore_errors=True)
            self._start = stack.enter_context(children())
            stack.callback(self._dismiss)
            for transport in self._wanted:
                self._add(transport)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    @property
    def names(self) -> tuple[str, ...]:
        """Those that are left."""
        return tuple(self._live)

    def parts(self, name: str) -> dict[str, int]:
        """The process ids of a contender, by what they are."""
        return {part.name: part.popen.pid for part in self._live[name].parts}

    def order(self, name: str, *order: object) -> None:
        """Tell a contender what to do next."""
        try:
            self._live[name].orders.send(order)
        except OSError:  # it has ended; `reply` finds out how
            pass

    def reply(self, name: str, meanwhile: Callable[[], None] = lambda: None) -> tuple[list[int], ...] | None:
        """What it measured (see `deploy.bench.peers`), or None if it is lost. Calls `meanwhile` often."""
        if name not in self._live:
            return None
        try:
            took: tuple[list[int], ...] = self._live[name].wait(self._patience_s, meanwhile)
            return took
        except Lost as lost:
            self.lose(name, str(lost))
            return None

    def check(self) -> None:
        """Drop those whose processes have ended."""
        for name, peer in [*self._live.items()]:
            try:
                peer.check()
            except Lost as lost:
                self.lose(name, str(lost))

    def lose(self, name: str, why: str) -> None:
        """Go on without a contender, for this reason."""
        peer = self._live.pop(name, None)
        if peer is not None:
            peer.orders.close()
            for part in peer.parts:
                _signal(part, signal.SIGKILL)
        self.lost[name] = why

    def join_ours(self, system: Deployment, seen: bytes) -> None:
        """Add the real fast node of `system`, with recorded observations sent to it in the simulator's place."""
        recorded = self._folder / "observation.bin"
        recorded.write_bytes(seen)
        self._meet(
            "ours",
            system.sockets,
            lambda: system.lost,
            lambda: [
                self._end(
                    "ours",
                    "near end",
                    PeerConfig(
                        transport="ours",
                        near=True,
                        folder=str(system.sockets),
                        observation=str(recorded),
                        realtime=self._realtime,
                    ),
                )
            ],
        )

    def _add(self, transport: Transport) -> None:
        sockets, port = self._sockets / transport, free_port()
        sockets.mkdir()
        far, near = (
            PeerConfig(
                transport=transport,
                near=near,
                folder=str(sockets),
                port=port,
                sent_bytes=self._sizes[0],
                answered_bytes=self._sizes[1],
                realtime=self._realtime,
            )
            for near in (False, True)
        )
        self._meet(
            transport,
            sockets,
            lambda: "",
            lambda: (
                [self._dora(sockets, far, near)]
                if transport == "dora"
                else [self._end(transport, "far end", far), self._end(transport, "near end", near)]
            ),
        )

    def _end(self, transport: str, name: str, config: PeerConfig) -> Child:
        return self._start(
            name,
            self._folder / f"{transport}-{name[:-4]}.log",
            sys.executable,
            "-m",
            "deploy.bench.peers",
            _json(config),
        )

    def _dora(self, folder: Path, far: PeerConfig, near: PeerConfig) -> Child:
        def node(name: str, other: str, config: PeerConfig) -> dict[str, object]:
            launcher = folder / f"{name}.py"
            launcher.write_text(
                "import sys\nsys.argv[1:] = [" + repr(_json(config)) + "]\nfrom deploy.bench import peers\n"
                "try:\n    peers.main()\nexcept (EOFError, KeyboardInterrupt):\n    pass\n",
                encoding="utf-8",
            )
            return {"id": name, "path": str(launcher), "inputs": {"in": f"{other}/out"}, "outputs": ["out"]}

        flow = folder / "flow.yml"
        flow.write_text(json.dumps({"nodes": [node("near", "far", near), node("far", "near", far)]}), encoding="utf-8")
        env = environment()
        env["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{env.get('PATH', '')}"
        return self._start("dataflow", self._folder / "dora.log", dora_command() or "dora", "run", str(flow), env=env)

    def _meet(self, name: str, sockets: Path, trouble: Callable[[], str], start: Callable[[], list[Child]]) -> None:
        """Start a contender and wait until its near end has come and is ready."""
        listener = self._stack.enter_context(Listener(socket_of(str(sockets), "orders")))
        met: list[Connection] = []

        def accept() -> None:
            try:
                met.append(listener.accept())
            except OSError:  # given up, and closed
                pass

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        parts = start()
        deadline = time.monotonic() + self._patience_s
        while not met:
            thread.join(0.02)
            why = trouble() or _trouble(parts)
            if not why and time.monotonic() > deadline:
                why = f"it did not come up within {self._patience_s:g} s{parts[-1].last_line()}"
            if why and not met:
                for part in parts:
                    _signal(part, signal.SIGKILL)
                self.lost[name] = why
                return
        peer = self._live[name] = _Peer(met[0], parts, trouble)
        try:
            _, self.scheduling[name] = peer.wait(self._patience_s, lambda: None)
            peer.wait(self._patience_s, lambda: None)
        except Lost as lost:
            self.lose(name, str(lost))

    def _dismiss(self) -> None:
        for peer in self._live.values():
            try:
                peer.orders.send(None)
                peer.orders.close()
            except OSError:
                pass


def _json(config: PeerConfig) -> str:
    return json.dumps(msgspec.to_builtins(config))


@contextmanager
def loaded(
    load: Load, model: Model, folder: Path, meanwhile: Callable[[], None] = lambda: None
) -> Iterator[dict[str, float]]:
    """Keeps the machine busy for the time of the block; yields what was done, complete at its end.

    Raises `Lost` if the load cannot be started, and at the end of the block if it did not last.
    """
    did: dict[str, float] = {}
    if load == "cpu":
        cores = str(os.cpu_count() or 1)
        did["threads"] = int(cores)
        with children() as start:
            hog = start(
                "matrix product",
                folder / "load.log",
                sys.executable,
                "-c",
                HOG,
                env={**environment(), "OPENBLAS_NUM_THREADS": cores},
            )
            yield did
            if why := hog.trouble():
                raise Lost(f"load cpu: {why}")
    elif load == "llm":
        with asking(model, did, meanwhile):
            yield did
    else:
        yield did


@contextmanager
def asking(model: Model, did: dict[str, float], meanwhile: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Has a served language model answer without pause, from its first word to the end of the block.

    Puts into `did`, at the end, the answers that were completed, the tokens that were written and the seconds it took;
    calls `meanwhile` while it waits. Raises `Lost` if the first word does not come, and at the end of the block if a
    request failed or no answer grew during it: then the load was not what it is called.
    """
    stop, asked = threading.Event(), _Asked()
    asker = threading.Thread(target=_ask, args=(model, stop, asked), daemon=True)
    asker.start()
    deadline = time.monotonic() + START_S
    try:
        while not asked.tokens:
            if time.monotonic() > deadline:
                raise Lost(f"the language model does not answer: {asked.failure or 'it is too slow'}")
            meanwhile()
            time.sleep(0.02)
        first, began = replace(asked), time.monotonic()
        yield
        last, seconds = replace(asked), time.monotonic() - began
        if last.failures > first.failures:
            raise Lost(
                f"the language model failed {last.failures - first.failures} requests, the last one with: "
                f"{last.failure}"
            )
        if last.tokens == first.tokens:
            raise Lost(f"the language model wrote nothing for {seconds:.0f} s")
        did.update(answers=last.answers - first.answers, tokens=last.tokens - first.tokens, seconds=round(seconds, 1))
    finally:
        stop.set()
        asker.join(GRACE_S)


@dataclass
class _Asked:
    """What has become of the requests so far."""

    answers: int = 0
    tokens: int = 0
    failures: int = 0
    failure: str = ""


def _ask(model: Model, stop: threading.Event, asked: _Asked) -> None:
    import httpx

    body = {
        "model": model.name,
        "max_tokens": 64,
        "stream": True,
        "messages": [{"role": "user", "content": "Tell me how to drive on a country road, in detail."}],
    }
    # A connection each: llama.cpp's server closes one that has streamed, and the next request would find it closed.
    alone = httpx.Limits(max_keepalive_connections=0)
    with httpx.Client(base_url=model.base_url, timeout=120.0, trust_env=False, limits=alone) as client:
        while not stop.is_set():
            try:
                with client.stream("POST", "/chat/completions", json=body) as reply:
                    for line in reply.raise_for_status().iter_lines():
                        asked.tokens += '"content":"' in line  # a token each
                        if stop.is_set():
                            return
                asked.answers += 1
            except httpx.HTTPError as error:
                asked.failure = str(error) or type(error).__name__
                asked.failures += 1
                stop.wait(0.5)
