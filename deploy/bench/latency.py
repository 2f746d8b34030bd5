"""`fastslow bench latency`: the real processes at their real pace, beside bare transports, in one interleaved run."""

from __future__ import annotations

import importlib.util
import json
import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np

from deploy.bench.deployed_system import Deployment
from deploy.bench.latency_report import bus_paced_minus_back_to_back, included, targets
from deploy.bench.latency_results import SCHEMA, TICKS_FOR_P999, histogram, row_of
from deploy.bench.latency_samples import PARTS, PERIOD_NS, Paced, Samples, p50_p99, read_traces
from deploy.bench.loads import BY_ITSELF, LOADS, Load, loaded
from deploy.bench.machine import host, rss_mb
from deploy.bench.pingpongs import PATIENCE_S, PingPongs, dora_command
from deploy.bench.progress import MeasurementError, say
from deploy.bench.transports import TRANSPORTS, Transport
from deploy.run.launch import children, python_module, temporary_folder
from schemas.driving.road import HZ
from schemas.runtime.bus import BusConfig, open_bus
from schemas.runtime.clock import NS
from schemas.runtime.realtime import Mode
from schemas.wire import topics
from schemas.wire.codec import encode

PACES = ("15hz", "back-to-back")
SETTLE_S = 2.0
"""Ticks before this are not counted: the load and the links come up."""
TURN = 200
"""Back to back, the participants take turns of this many rounds."""
STARTS = 5
NOT_INSTALLED = "not installed: pip install 'fastslow[bench]'"
BLOCK_S = 60.0
"""Several loads take turns of this long, or of a quarter of their time."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """What a user may choose. `seconds` is the paced time under each load."""

    seconds: float = 240.0
    loads: tuple[Load, ...] = BY_ITSELF
    realtime: Mode = "auto"
    peers: tuple[Transport, ...] = TRANSPORTS
    out: Path | None = None


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


def blocks(seconds: float, loads: Sequence[Load]) -> list[tuple[Load, float]]:
    """In which order the loads are measured at 15 Hz, and for how many seconds each time.

    They take turns, every other round backwards, so that the drift of a busy machine does not land in their ratios.
    """
    rounds = max(1, round(seconds / min(BLOCK_S, seconds / 4))) if len(loads) > 1 else 1
    return [(load, seconds / rounds) for i in range(rounds) for load in (loads if i % 2 == 0 else loads[::-1])]


def _paced(options: Options, load: Load, folder: Path, samples: Samples) -> None:
    """One paced block of one load, of `options.seconds`; it adds to what the blocks before have found.

    A peer that was lost under this load is not tried again. Raises `MeasurementError` if the load itself is lost.
    """
    n = round(options.seconds * HZ)
    wanted = tuple(peer for peer in options.peers if (peer, load, "15hz") not in samples.absent)
    for name in ("sim.trace", "fast.trace"):  # those of the block before
        (folder / name).unlink(missing_ok=True)
    found: dict[str, tuple[list[int], ...]] = {}
    with ExitStack() as stack:
        system = stack.enter_context(
            Deployment(
                folder, options.realtime, *(() if load == "llm" else ("llm",)), trace=True, watched=load == "watched"
            )
        )
        try:
            system.ready()
            system.until(lambda: system.newest is not None and system.action_bytes > 0, "the first tick")
            assert system.newest is not None
            samples.seen, samples.sizes = encode(system.newest), (len(encode(system.newest)), system.action_bytes)
        except MeasurementError:
            _check_load(load, system)
        peers = stack.enter_context(PingPongs(folder, wanted, *samples.sizes, options.realtime))
        did = stack.enter_context(loaded(load, system.model, folder, system.step, system.page))
        if load == "watched":
            system.until(lambda: all(_watched(system).values()), "a page with frames and a recording")
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
        if load == "watched":
            did |= _watched(system)
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
            read_traces(folder, load, first, ends, samples)
        except MeasurementError as lost:
            system.lost = str(lost)
    for name, why in {**peers.lost, **({"ours": system.lost} if system.lost else {})}.items():
        samples.lose((name, load, "15hz"), why)


def _check_load(load: Load, system: Deployment) -> None:
    """Raises `MeasurementError` if what makes the load has died: the others are not under it then."""
    if system.lost_process in {"llm": ("llm",), "watched": ("cockpit", "record")}.get(load, ()):
        raise MeasurementError(f"load {load}: {system.lost}")


def _watched(system: Deployment) -> dict[str, float]:
    """How many pages look, how many frames they were shown, and how many messages were recorded."""
    cockpit, recorder = (system.metrics.get(name, {}) for name in ("cockpit", "record"))
    return {
        "pages": cockpit.get("pages", 0.0),
        "frames": cockpit.get("frames", 0.0),
        "messages recorded": recorder.get("messages", 0.0),
    }


def _with_inference(took: list[int], inferred: list[int]) -> list[int]:
    return [a + b for a, b in zip(took, inferred, strict=True)] if inferred else took


def _next_tick_ns(system: Deployment) -> int:
    """When the simulator's next tick was stamped, or now if there is no simulator any more."""
    before = system.newest
    try:
        system.until(lambda: system.newest is not before, "a tick")
    except MeasurementError:
        return time.monotonic_ns()
    assert system.newest is not None
    return system.newest.stamp_ns


def _back_to_back(options: Options, load: Load, folder: Path, samples: Samples) -> None:
    """The back-to-back half of one load, in turns. Raises `MeasurementError` if the load itself is lost."""
    rounds = max(TURN, min(20_000, round(options.seconds * 50)) // TURN * TURN)
    without = ("sim", "slow") if load == "llm" else ("sim", "slow", "llm")
    found: dict[str, list[int]] = {}
    with ExitStack() as stack:
        system = stack.enter_context(Deployment(folder, options.realtime, *without, trace=False))
        try:
            system.ready()
        except MeasurementError:
            _check_load(load, system)
        peers = stack.enter_context(PingPongs(folder, options.peers, *samples.sizes, options.realtime))
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

    Raises `MeasurementError` if it gives none.
    """
    seconds: list[float] = []
    memory: float | None = None
    for _ in range(STARTS):
        with temporary_folder() as sockets:
            near, fast = (f"unixsock-stream/{sockets / name}.sock" for name in ("near", "fast"))
            argv = python_module("fast_node", {"bus": {"listen": [fast], "low_latency": True}})
            with children() as start, open_bus(BusConfig(listen=(near,), connect=(fast,), low_latency=True)) as bus:
                actions = bus.subscribe_bytes(topics.ACTION)
                began = time.monotonic()
                node = start("fast node", argv, folder / "starts.log")
                while not actions.take():
                    if why := node.trouble():
                        raise MeasurementError(why)
                    if time.monotonic() - began > PATIENCE_S:
                        raise MeasurementError(f"the fast node gave no action for {PATIENCE_S:g} s{node.last_line()}")
                    bus.publish_bytes(topics.OBSERVATION, seen)
                    time.sleep(0.002)
                seconds.append(time.monotonic() - began)
                memory = rss_mb(node.pid)
    return {"first_action_s": round(float(np.median(seconds)), 3), "starts": STARTS, "rss_mb": memory}


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
    if options.seconds * HZ < TICKS_FOR_P999:
        say(
            f"bench: {options.seconds:g} s are {options.seconds * HZ:.0f} ticks: too few for p99.9, which needs "
            f"{TICKS_FOR_P999} ({TICKS_FOR_P999 / HZ:.0f} s)"
        )
    fast: dict[str, object] = {}

    def measure(part: Callable[[Options, Load, Path, Samples], None], seconds: float, load: Load, pace: str) -> None:
        try:
            part(replace(options, seconds=seconds), load, folder, samples)
        except MeasurementError as lost:
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
        if load == "watched":  # there is no simulator to watch
            continue
        measure(_back_to_back, options.seconds, load, "back-to-back")
    if samples.seen:
        try:
            fast = first_actions(folder, samples.seen)
        except MeasurementError as lost:
            samples.lose(("ours", options.loads[-1], "start"), str(lost))
    rows = [
        row_of(*key, took, samples.skipped[key])
        for key, took in sorted(
            samples.took.items(), key=lambda item: (LOADS.index(cast(Load, item[0][1])), item[0][2], item[0][0])
        )
    ]
    result: dict[str, Any] = {
        "schema": SCHEMA,
        "host": {**machine, "payload_bytes": dict(zip(("observation", "action"), samples.sizes, strict=True))},
        "rows": [msgspec.to_builtins(row) for row in rows],
        "absent": [
            {"what": what, "load": load, "pace": pace, "why": why} for (what, load, pace), why in samples.absent.items()
        ],
        "parts_us": {
            load: {name: p50_p99(values) for name, values in paced.parts.items()}
            for load, paced in samples.paced.items()
            if paced.parts[PARTS[0]]
        },
        "bus_paced_minus_back_to_back_us": bus_paced_minus_back_to_back(rows),
        "loads": {load: paced.figures() for load, paced in samples.paced.items()},
        "fast_node": fast,
        "targets": targets(rows, fast, options.realtime, samples.age_us("none")),
        "included": included({row.what for row in rows}),
        "histograms": {"/".join(key): histogram(took) for key, took in samples.took.items()},
    }
    path = folder / "latency.json"
    path.write_text(json.dumps(result) + "\n", encoding="utf-8")
    return result, path
