"""`fastslow bench latency`: the real processes at their real pace, beside bare transports, in one interleaved run."""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np

from deploy.bench import figures
from deploy.bench.contenders import (
    LOADS,
    PATIENCE_S,
    Deployment,
    Load,
    Lost,
    Peers,
    children,
    dora_command,
    loaded,
    rss_mb,
    say,
    trace_of,
)
from deploy.bench.peers import Transport
from schemas.runtime.bus import BusConfig, open_bus
from schemas.runtime.clock import NS
from schemas.runtime.process import revision
from schemas.runtime.realtime import Mode, resolve, trial
from schemas.wire import topics
from schemas.wire.codec import encode

PEERS: tuple[Transport, ...] = ("floor", "bus", "bus-default", "zmq", "dora")
PACES = ("15hz", "back-to-back")
HZ = 15
PERIOD_NS = NS // HZ
SETTLE_S = 2.0
"""Ticks before this are not counted: the load and the links come up."""
TURN = 200
"""Back to back, the contenders take turns of this many rounds."""
STARTS = 5
TYPICAL_BYTES = (1024, 256)
"""Of an observation and an action, for the others' payloads while ours has sent none."""
SOAK_TICKS = 13_500
"""15 minutes."""
DISTURBED = 1.25
"""An idle p99 this many times a load's tells of something else that kept the machine busy."""
PARTS = (
    "sim: encode and put",
    "bus out",
    "decode",
    "mask",
    "features",
    "policy",
    "rest of the step",
    "encode and put",
    "bus back",
)
"""Of ours, in the order of time. `bus out` starts when the simulator's put has returned: it is negative where the fast
node had the observation before that."""
NOT_INSTALLED = "not installed: pip install 'fastslow[bench]'"
BLOCK_S = 60.0
"""Several loads take turns of this long, or of a quarter of their time."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """What a user may choose. `seconds` is the paced time under each load."""

    seconds: float = 240.0
    loads: tuple[Load, ...] = LOADS
    realtime: Mode = "auto"
    peers: tuple[Transport, ...] = PEERS
    out: Path | None = None


@dataclass
class Paced:
    """What else the paced blocks of one load have shown so far, all of them together."""

    parts: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in PARTS})
    """Of ours, in us."""
    ages: list[float] = field(default_factory=list)
    """Of the observation that each applied action answers, in us."""
    late: dict[str, list[float]] = field(default_factory=dict)
    """By contender, in us: from when a round was due until it was sent; for ours, until it was published."""
    skipped: int = 0
    """Ticks that the simulator left out."""
    overdue: int = 0
    """Ticks published more than a period after they were due."""
    load: dict[str, float] = field(default_factory=dict)
    """What the load did; see `loaded`."""
    rss_mb: dict[str, float | None] = field(default_factory=dict)
    """Of the last block, as is `scheduling`."""
    scheduling: dict[str, str] = field(default_factory=dict)

    def loaded(self, did: dict[str, float]) -> None:
        """Add what the load did in one more block."""
        for name, value in did.items():
            self.load[name] = value if name == "threads" else round(self.load.get(name, 0) + value, 1)
        if self.load.get("seconds"):
            self.load["tokens_per_s"] = round(self.load["tokens"] / self.load["seconds"], 1)

    def figures(self) -> dict[str, Any]:
        """For the result."""
        return {
            "load": self.load,
            "rss_mb": self.rss_mb,
            "scheduling": self.scheduling,
            "timer_late_us": {name: _p50_p99(us) for name, us in self.late.items() if us},
            "applied_age_us": _p50_p99(self.ages),
            "skipped_ticks": self.skipped,
            "overdue_ticks": self.overdue,
        }


@dataclass
class Samples:
    """Round trips in us, by what, load and pace, and what else was seen."""

    took: dict[tuple[str, str, str], list[float]] = field(default_factory=dict)
    skipped: dict[tuple[str, str, str], int] = field(default_factory=dict)
    """Due times at which nothing was sent in time."""
    paced: dict[str, Paced] = field(default_factory=dict)
    """By load."""
    absent: dict[tuple[str, str, str], str] = field(default_factory=dict)
    """What should have been measured, and why it was not."""
    seen: bytes = b""
    """An observation of the real simulator, encoded."""
    block: str = ""
    """Which one is being measured, if there are several; part of the reason of a loss."""
    sizes: tuple[int, int] = TYPICAL_BYTES
    """Of an observation and an action."""

    def add(self, key: tuple[str, str, str], took_ns: Sequence[int], skipped: int = 0) -> None:
        self.took.setdefault(key, []).extend(t / 1000.0 for t in took_ns)
        self.skipped[key] = self.skipped.get(key, 0) + skipped

    def lose(self, key: tuple[str, str, str], why: str) -> None:
        """One row less, or a part of it, which is said at once."""
        why += self.block
        self.absent[key] = why
        say(f"bench: load {key[1]}, {key[2]}: without {key[0]}: {why}")


def available(wanted: tuple[Transport, ...]) -> tuple[Transport, ...]:
    """The peers that can run here; says which cannot, and why."""
    packages = {"zmq": ("zmq",), "dora": ("dora", "pyarrow")}
    found: list[Transport] = []
    for peer in wanted:
        missing = [name for name in packages.get(peer, ()) if importlib.util.find_spec(name) is None]
        if peer == "dora" and not missing and not dora_command():
            missing = ["the dora command (dora-rs-cli)"]
        if missing:
            say(f"bench: without {peer}: {', '.join(missing)} {NOT_INSTALLED}")
        else:
            found.append(peer)
    return tuple(found)


# --- measuring ---------------------------------------------------------------------------------------------------


def blocks(seconds: float, loads: Sequence[Load]) -> list[tuple[Load, float]]:
    """In which order the loads are measured at 15 Hz, and for how many seconds each time.

    They take turns, every other round backwards, so that the drift of a busy machine does not land in their ratios.
    """
    rounds = max(1, round(seconds / min(BLOCK_S, seconds / 4))) if len(loads) > 1 else 1
    return [(load, seconds / rounds) for i in range(rounds) for load in (loads if i % 2 == 0 else loads[::-1])]


def _paced(options: Options, load: Load, folder: Path, samples: Samples) -> None:
    """One paced block of one load, of `options.seconds`; it adds to what the blocks before have found.

    A peer that was lost under this load is not tried again. Raises `Lost` if the load itself is lost.
    """
    n = round(options.seconds * HZ)
    wanted = tuple(peer for peer in options.peers if (peer, load, "15hz") not in samples.absent)
    for name in ("sim.trace", "fast.trace"):  # those of the block before
        (folder / name).unlink(missing_ok=True)
    found: dict[str, tuple[list[int], ...]] = {}
    with ExitStack() as stack:
        system = stack.enter_context(
            Deployment(folder, options.realtime, *(() if load == "llm" else ("llm",)), trace=True)
        )
        try:
            system.ready()
            system.until(lambda: system.newest is not None and system.action_bytes > 0, "the first tick")
            assert system.newest is not None
            samples.seen, samples.sizes = encode(system.newest), (len(encode(system.newest)), system.action_bytes)
        except Lost:
            _check_load(load, system)
        peers = stack.enter_context(Peers(folder, wanted, *samples.sizes, options.realtime))
        did = stack.enter_context(loaded(load, system.model, folder, system.step))
        system.watch(SETTLE_S)
        first = _next_tick_ns(system) + PERIOD_NS * 3
        for i, name in enumerate(peers.names, start=1):
            peers.order(name, "paced", first + i * PERIOD_NS // (len(peers.names) + 1), PERIOD_NS, n)
        ends, said = first + n * PERIOD_NS, time.monotonic()
        while time.monotonic_ns() < ends:
            system.watch(0.05)
            peers.check()
            if time.monotonic() - said >= 10.0:
                said = time.monotonic()
                say(f"bench: load {load}: 15 Hz, {(time.monotonic_ns() - first) / NS:.0f} of {options.seconds:g} s")
        for name in peers.names:
            if (reply := peers.reply(name, system.step)) is not None:
                found[name] = reply
        _check_load(load, system)
        memory = {name: system.rss_mb(name) for name in ("sim", "fast")}
        scheduling = {**{name: system.scheduling(name) for name in ("sim", "fast")}, **peers.scheduling}
    paced = samples.paced.setdefault(load, Paced())
    paced.loaded(did)
    paced.rss_mb.update(memory)
    paced.scheduling.update(scheduling)
    for name, (took, late, inferred) in found.items():
        samples.add((name, load, "15hz"), _with_inference(took, inferred))
        paced.late.setdefault(name, []).extend(ns / 1000.0 for ns in late)
    if not system.lost:
        try:
            _read_traces(folder, load, first, ends, samples)
        except Lost as lost:
            system.lost = str(lost)
    for name, why in {**peers.lost, **({"ours": system.lost} if system.lost else {})}.items():
        samples.lose((name, load, "15hz"), why)


def _check_load(load: Load, system: Deployment) -> None:
    """Raises `Lost` if the language model died under its own load: what else is measured then is not under it."""
    if load == "llm" and system.lost_process == "llm":
        raise Lost(f"load llm: {system.lost}")


def _with_inference(took: list[int], inferred: list[int]) -> list[int]:
    return [a + b for a, b in zip(took, inferred, strict=True)] if inferred else took


def _next_tick_ns(system: Deployment) -> int:
    """When the simulator's next tick was stamped, or now if there is no simulator any more."""
    before = system.newest
    try:
        system.until(lambda: system.newest is not before, "a tick")
    except Lost:
        return time.monotonic_ns()
    assert system.newest is not None
    return system.newest.stamp_ns


def _read_traces(folder: Path, load: Load, first: int, ends: int, samples: Samples) -> None:
    """From the nodes' own stamps of the ticks due between `first` and `ends` [CLOCK_MONOTONIC ns], add to `samples` the
    round trips, their parts, how late they were published, and the ages of what was applied.

    Raises `Lost` if there are none.
    """
    sim = trace_of(folder / "sim.trace").tolist()
    fast = {(row[0], row[1]): row for row in trace_of(folder / "fast.trace").tolist()}
    published = {(epoch, tick): at for epoch, tick, at, *_ in sim}
    paced = samples.paced.setdefault(load, Paced())
    late = paced.late.setdefault("ours", [])
    took: list[int] = []
    missed = 0
    for epoch, tick, sent, answered, due, put, next_due, next_ns, applied in sim:
        if not first <= due < ends:
            continue
        skipped = max(0, round((next_due - due) / PERIOD_NS) - 1)
        paced.skipped += skipped
        took.append(answered if answered >= 0 else max(PERIOD_NS, next_ns - sent))
        late.append((sent - due) / 1000.0)
        overdue = sent - due > PERIOD_NS
        paced.overdue += overdue
        missed += skipped + (overdue and took[-1] <= figures.DEADLINE_US * 1000.0)  # the later ones count by themselves
        if (epoch, applied) in published:
            paced.ages.append((next_ns - published[epoch, applied]) / 1000.0)
        row = fast.get((epoch, tick))
        if row is None or answered < 0:
            continue
        _, _, arrived, decoded, mask, features, policy, stepped, answer = row
        for name, ns in zip(
            PARTS,
            (
                put - sent,
                arrived - put,
                decoded - arrived,
                mask,
                features,
                policy,
                stepped - decoded - mask - features - policy,
                answer - stepped,
                sent + answered - answer,
            ),
            strict=True,
        ):
            paced.parts[name].append(ns / 1000.0)
    if not took:
        raise Lost("the simulator did not tick")
    samples.add(("ours", load, "15hz"), took, missed)


def _back_to_back(options: Options, load: Load, folder: Path, samples: Samples) -> None:
    """The back-to-back half of one load: the contenders take turns. Raises `Lost` if the load itself is lost."""
    rounds = max(TURN, min(20_000, round(options.seconds * 50)) // TURN * TURN)
    without = ("sim", "slow") if load == "llm" else ("sim", "slow", "llm")
    found: dict[str, list[int]] = {}
    with ExitStack() as stack:
        system = stack.enter_context(Deployment(folder, options.realtime, *without, trace=False))
        try:
            system.ready()
        except Lost:
            _check_load(load, system)
        peers = stack.enter_context(Peers(folder, options.peers, *samples.sizes, options.realtime))
        if system.lost or not samples.seen:
            peers.lose("ours", system.lost or "no observation to replay")
        else:
            peers.join_ours(system, samples.seen)
        stack.enter_context(loaded(load, system.model, folder, system.step))
        say(f"bench: load {load}: back to back, {rounds} rounds each")
        for _ in range(rounds // TURN):
            for name in peers.names:
                peers.order(name, "rounds", TURN)
                if (reply := peers.reply(name, system.step)) is not None:
                    found.setdefault(name, []).extend(_with_inference(reply[0], reply[2]))
        _check_load(load, system)
    for name, why in peers.lost.items():
        samples.lose((name, load, "back-to-back"), why)
    for name, took in found.items():
        if name not in peers.lost:
            samples.add((name, load, "back-to-back"), took)


def first_actions(folder: Path, seen: bytes) -> dict[str, object]:
    """Start the fast node again and again, alone: seconds from the process's start to its first action, and its RSS.

    Raises `Lost` if it gives none.
    """
    seconds: list[float] = []
    memory: float | None = None
    for _ in range(STARTS):
        sockets = Path(tempfile.mkdtemp(prefix="fastslow-"))
        near, fast = (f"unixsock-stream/{sockets / name}.sock" for name in ("near", "fast"))
        config = json.dumps({"bus": {"listen": [fast], "low_latency": True}})
        try:
            with children() as start, open_bus(BusConfig(listen=(near,), connect=(fast,), low_latency=True)) as bus:
                actions = bus.subscribe_bytes(topics.ACTION)
                began = time.monotonic()
                node = start("fast node", folder / "starts.log", sys.executable, "-m", "fast_node", config)
                while not actions.take():
                    if (why := node.trouble()) or time.monotonic() - began > PATIENCE_S:
                        raise Lost(why or f"the fast node gave no action for {PATIENCE_S:g} s{node.last_line()}")
                    bus.publish_bytes(topics.OBSERVATION, seen)
                    time.sleep(0.002)
                seconds.append(time.monotonic() - began)
                memory = rss_mb(node.popen.pid)
        finally:
            shutil.rmtree(sockets, ignore_errors=True)
    return {"first_action_s": round(float(np.median(seconds)), 3), "starts": STARTS, "rss_mb": memory}


# --- the result --------------------------------------------------------------------------------------------------


def _p50_p99(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    p50, p99 = (round(float(p), 1) for p in np.percentile(values, (50, 99)))
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
        "revision": revision(),
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "kernel": f"{platform.system()} {platform.release()}",
        "load_average": [round(x, 2) for x in os.getloadavg()],
        "realtime": trial(realtime),
        "versions": versions,
    }


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def targets(rows: Sequence[figures.Row], fast: dict[str, object], realtime: Mode) -> list[dict[str, object]]:
    """The figures that were promised, those of them that this run has. `valid` is false, and `note` says why, where a
    figure cannot be judged; it is not reached then."""
    by = {(row.what, row.load, row.pace): row for row in rows}
    found: list[dict[str, object]] = []

    def check(figure: str, value: float | None, limit: float, *, at_least: bool = False, invalid: str = "") -> None:
        if value is not None:
            reached = value >= limit if at_least else value <= limit
            found.append(
                {
                    "figure": figure,
                    "value": round(value, 3),
                    "limit": limit,
                    "reached": reached and not invalid,
                    "valid": not invalid,
                    "note": invalid or None,
                }
            )

    ours, floor = by.get(("ours", "none", "15hz")), by.get(("floor", "none", "15hz"))
    if ours is not None:
        if floor is not None:
            check("paced p50, ours / floor", ours.p50_us / floor.p50_us, 1.5)
            check("paced p99, ours / floor", ours.p99_us / floor.p99_us, 1.5)
        check("paced p99, ours [ms]", ours.p99_us / 1000.0, 1.2)
        for load in ("cpu", "llm"):
            busy = by.get(("ours", load, "15hz"))
            if busy is not None:
                disturbed = ours.p99_us > DISTURBED * busy.p99_us
                check(
                    f"paced p99, load {load} / none",
                    busy.p99_us / ours.p99_us,
                    1.25 if resolve(realtime) == "fifo" else 2.0,
                    invalid="the idle part was disturbed: its p99 is above the load's" if disturbed else "",
                )
        for pace in ("15hz", "back-to-back"):
            dora = by.get(("dora", "none", pace))
            for what in ("bus", "ours"):
                mine = by.get((what, "none", pace))
                if dora is not None and mine is not None:
                    check(f"p50 {pace}, dora / {what}", dora.p50_us / mine.p50_us, 4.0, at_least=True)
    soak = by.get(("ours", "llm", "15hz"))
    if soak is not None and soak.n + soak.misses >= SOAK_TICKS:  # n alone lacks the skipped ticks, which are misses
        check(f"missed deadlines of {soak.n} ticks, load llm", float(soak.misses), 0.0)
    check("fast node, start to first action [s]", cast("float | None", fast.get("first_action_s")), 0.5)
    check("fast node, resident memory [MB]", cast("float | None", fast.get("rss_mb")), 100.0)
    return found


def bus_paced_minus_back_to_back(rows: Sequence[figures.Row]) -> dict[str, float]:
    """By load: p50 of the bare bus at 15 Hz minus p50 of the bare bus back to back [us].

    Mostly what it costs to wake two processes that slept, with cold caches. It says nothing of ours, which under
    SCHED_FIFO polls for what is about to come, while the bus contender sleeps.
    """
    bus = {(row.load, row.pace): row.p50_us for row in rows if row.what == "bus"}
    return {
        load: round(bus[load, "15hz"] - bus[load, "back-to-back"], 1)
        for load in LOADS
        if {(load, "15hz"), (load, "back-to-back")} <= bus.keys()
    }


def included(whats: Set[str]) -> list[str]:
    """What the figures of these contenders are made of, and what counts as a miss."""
    bare = ", ".join(peer for peer in PEERS if peer in whats - {"floor"})
    said = {
        "ours": "ours: from just before sim encodes and publishes an observation until sim has decoded the action that "
        "answers it, over the bus as deployed (supervisor's router, slow node, 5 Hz heartbeats). The "
        "simulator's step comes before; it is within ours of `timer_late_us`, from due until published. Under "
        "SCHED_FIFO with a second core, sim and fast poll for what is about to come, while the bare transports "
        "sleep until it is there. Back to back: a recorded observation is replayed to the real fast node, "
        "since the simulator's own step would lie between.",
        "floor": "floor: a Unix-socket ping-pong of the same payload sizes, plus one bare policy inference in a warm "
        "loop.",
        bare: f"{bare}: a ping-pong of the same payload sizes, with nothing done to the payloads.",
    }
    return [
        *(text for what, text in said.items() if what and (what == bare or what in whats)),
        "Paced, each contender has its own slice of the 66.7 ms. All have the same scheduling class. A miss of "
        "ours: the answer came more than 20 ms after the publication, or never, or the publication itself was more "
        "than one period after the tick was due, or the tick was skipped. A miss of the others: the answer came "
        "more than 20 ms after the sending; a round whose predecessor was late counts from when it was due.",
    ]


def run(options: Options) -> tuple[dict[str, Any], Path]:
    """Measure, save and return the result and where it is. What could not be measured is in its `absent`."""
    folder = options.out or Path("runs") / f"bench-{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}"
    folder.mkdir(parents=True, exist_ok=True)
    machine, samples = host(options.realtime), Samples()
    installed = available(options.peers)
    samples.absent.update(
        {
            (peer, load, pace): NOT_INSTALLED
            for load in options.loads
            for pace in PACES
            for peer in options.peers
            if peer not in installed
        }
    )
    options = replace(options, peers=installed)
    if options.seconds * HZ < figures.TICKS_FOR_P999:
        say(
            f"bench: {options.seconds:g} s are {options.seconds * HZ:.0f} ticks: too few for p99.9, which needs "
            f"{figures.TICKS_FOR_P999} ({figures.TICKS_FOR_P999 / HZ:.0f} s)"
        )
    fast: dict[str, object] = {}

    def measure(part: Callable[[Options, Load, Path, Samples], None], seconds: float, load: Load, pace: str) -> None:
        try:
            part(replace(options, seconds=seconds), load, folder, samples)
        except Lost as lost:
            for what in (*options.peers, "ours"):
                samples.lose((what, load, pace), str(lost))
            gone.add((load, pace))

    gone: set[tuple[str, str]] = set()
    order = blocks(options.seconds, options.loads)
    for i, (load, seconds) in enumerate(order, start=1):
        samples.block = f" (block {i} of {len(order)})" if len(order) > 1 else ""
        if (load, "15hz") not in gone:
            say(f"bench: load {load}: 15 Hz, {seconds:g} s, block {i} of {len(order)}")
            measure(_paced, seconds, load, "15hz")
    samples.block = ""
    for load in options.loads:
        measure(_back_to_back, options.seconds, load, "back-to-back")
    if samples.seen:
        try:
            fast = first_actions(folder, samples.seen)
        except Lost as lost:
            samples.lose(("ours", options.loads[-1], "start"), str(lost))
    rows = [
        figures.row_of(*key, took, samples.skipped[key])
        for key, took in sorted(
            samples.took.items(), key=lambda item: (LOADS.index(cast(Load, item[0][1])), item[0][2], item[0][0])
        )
    ]
    result: dict[str, Any] = {
        "schema": figures.SCHEMA,
        "host": {**machine, "payload_bytes": dict(zip(("observation", "action"), samples.sizes, strict=True))},
        "rows": [msgspec.to_builtins(row) for row in rows],
        "absent": [
            {"what": what, "load": load, "pace": pace, "why": why} for (what, load, pace), why in samples.absent.items()
        ],
        "parts_us": {
            load: {name: _p50_p99(values) for name, values in paced.parts.items()}
            for load, paced in samples.paced.items()
            if paced.parts[PARTS[0]]
        },
        "bus_paced_minus_back_to_back_us": bus_paced_minus_back_to_back(rows),
        "loads": {load: paced.figures() for load, paced in samples.paced.items()},
        "fast_node": fast,
        "targets": targets(rows, fast, options.realtime),
        "included": included({row.what for row in rows}),
        "histograms": {"/".join(key): figures.histogram(took) for key, took in samples.took.items()},
    }
    path = folder / "latency.json"
    path.write_text(json.dumps(result) + "\n", encoding="utf-8")
    return result, path


def lines(result: dict[str, Any]) -> Iterator[str]:
    """The result for people."""
    machine = result["host"]
    yield (
        f"{machine['cpu']}, {machine['cores']} cores, {machine['kernel']}, scheduling: {machine['realtime']}, "
        f"load average {machine['load_average'][0]:g} at the start"
    )
    versions = {**machine["versions"], "commit": machine["revision"]}
    yield ", ".join(f"{name} {number}" for name, number in versions.items() if number)
    yield from figures.table(result["rows"])
    for row in result["absent"]:
        yield f"{row['load']:<5} {row['pace']:<13} {row['what']:<12} absent: {row['why']}"
    for load, paced in result["loads"].items():
        if paced["load"]:
            yield f"load {load}: " + ", ".join(f"{name} {value:g}" for name, value in paced["load"].items())
        yield f"scheduling, load {load}: " + ", ".join(f"{name} {said}" for name, said in paced["scheduling"].items())
        yield (
            f"sent after it was due, load {load}, p50/p99 us: {_p50s(paced['timer_late_us'])}"
            " (ours: published, with the simulator's step before it)"
        )
        if load in result["parts_us"]:
            yield f"parts of ours, load {load}, p50/p99 us: {_p50s(result['parts_us'][load])}"
        if paced["applied_age_us"] is not None:
            age = {"age of the observation that each applied action answers": paced["applied_age_us"]}
            yield f"load {load}, p50/p99 us: {_p50s(age)}"
    for load, us in result["bus_paced_minus_back_to_back_us"].items():
        yield (
            f"load {load}: p50 of the bare bus at 15 Hz minus back to back: {us:.0f} us, mostly wake-ups; under "
            "SCHED_FIFO ours polls, while the bare bus sleeps"
        )
    for target in result["targets"]:
        judged = "INVALID" if not target["valid"] else "reached" if target["reached"] else "MISSED"
        note = f"; {target['note']}" if target["note"] else ""
        yield f"{judged:<8} {target['figure']}: {target['value']:g} (limit {target['limit']:g}{note})"
    for text in result["included"]:
        yield f"included: {text}"


def _p50s(figures_of: dict[str, dict[str, float]]) -> str:
    return ", ".join(f"{name} {f['p50']:.0f}/{f['p99']:.0f}" for name, f in figures_of.items())
