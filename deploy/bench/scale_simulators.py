"""How the simulators' cost grows: pairs of simulator and fast node on one bus, and one simulator's own tick."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from deploy.bench.deployed_system import START_S, trace_of
from deploy.bench.latency_results import DEADLINE_US
from deploy.bench.latency_samples import PERIOD_NS
from deploy.bench.machine import idle_s
from deploy.bench.progress import MeasurementError
from deploy.bench.scale_points import Point, broken, point_of
from deploy.run.launch import Launched, children, python_module
from schemas.runtime.bus import BusConfig, open_bus
from schemas.runtime.realtime import Mode, resolve
from schemas.wire.messages import Action, MetaAction
from sim_node.config import SimConfig
from sim_node.node import SimNode
from sim_node.scenarios import SCENARIOS

PAIRS = (1, 2, 4, 8, 16, 32, 48, 64)
TICK_CARS = 2.5
"""Times the cars of our highway: 50 and a few."""
TICK_MS = 5.0
"""What the simulator's tick may take at p99."""
SETTLE_S = 1.0


def simulators(folder: Path, realtime: Mode, seconds: float, *, direct: bool) -> list[Point]:
    """By pairs of simulator and fast node on one bus, up to the first number that breaks. `direct`: linked in pairs."""
    points: list[Point] = []
    for pairs in PAIRS:
        try:
            points.append(_pairs(folder, realtime, seconds, pairs, direct=direct))
        except MeasurementError as lost:
            points.append({"x": pairs, "breaks": str(lost)})
        if broken(points[-1]):
            break
    return points


def _pairs(folder: Path, realtime: Mode, seconds: float, pairs: int, *, direct: bool) -> Point:
    took: list[int] = []
    skipped = 0
    with tempfile.TemporaryDirectory(prefix="fastslow-") as sockets:
        router = f"unixsock-stream/{sockets}/router.sock"
        with children() as start, open_bus(BusConfig(mode="router", listen=(router,))):

            def node(module: str, i: int, *, listens: bool = False, **config: object) -> Launched:
                link = [f"unixsock-stream/{sockets}/{i}.sock"] if direct else []
                bus = {
                    "mode": "peer" if direct else "client",
                    "listen": link if listens else [],
                    "connect": [router, *([] if listens else link)],
                    "namespace": f"car-{i}",
                    "low_latency": True,
                }
                with _room(realtime, i):
                    argv = python_module(module, {"bus": bus, "realtime": realtime, **config})
                    return start(f"{module} {i}", argv, folder / f"{module}-{i}.log")

            nodes = [node("fast_node", i, listens=True) for i in range(pairs)]
            _ready(nodes)
            nodes += [node("sim_node", i, seed=i, trace=f"{sockets}/{i}.trace") for i in range(pairs)]
            _ready(nodes)
            time.sleep(SETTLE_S)
            idle, first = idle_s(), time.monotonic_ns()
            time.sleep(seconds)
            ends = time.monotonic_ns()
            idle = idle_s() - idle
            _ready(nodes)
        for i in range(pairs):
            one, late = _round_trips(Path(sockets) / f"{i}.trace", first, ends)
            took, skipped = took + one, skipped + late
    late = sum(ns > 1000 * DEADLINE_US for ns in took)
    busy = round(1.0 - idle / (seconds * (os.cpu_count() or 1)), 2)
    return point_of(pairs, took, misses=late + skipped, cores_busy=busy)


@contextmanager
def _room(realtime: Mode, pair: int) -> Iterator[None]:
    """What is started within the block has one core, by its pair's number, where it would choose one by itself: all
    pairs would choose the same one."""
    if resolve(realtime) != "user":
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {sorted(cores)[pair % len(cores)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def _ready(nodes: Sequence[Launched]) -> None:
    """Wait until all have said so. Raises `MeasurementError` if one has ended or does not."""
    limit_s = START_S + 2.0 * len(nodes)  # they all start at once, on few cores
    deadline = time.monotonic() + limit_s
    waiting = list(nodes)
    while waiting:
        if why := next(filter(None, (node.trouble() for node in nodes)), ""):
            raise MeasurementError(why)
        if time.monotonic() > deadline:
            raise MeasurementError(f"{waiting[0].name} is not ready after {limit_s:g} s{waiting[0].last_line()}")
        waiting = [node for node in waiting if b'"ready"' not in node.log.read_bytes()]
        time.sleep(0.05)


def _round_trips(trace: Path, first: int, ends: int) -> tuple[list[int], int]:
    """Round trips [ns] of the ticks published within first..ends, a whole period if unanswered, and skipped ticks."""
    sent, answered, due, _, next_due, after = trace_of(trace).T[2:8]
    within = (first <= sent) & (sent < ends)
    took = np.where(answered >= 0, answered, np.maximum(PERIOD_NS, after - sent))[within]
    skipped = np.rint((next_due - due)[within] / PERIOD_NS).astype(int) - 1
    return took.tolist(), int(skipped.clip(0).sum())


def simulator_tick(ticks: int) -> Point:
    """The simulator's own tick, from an action to an observation, among some 50 vehicles; `x`: the fewest there were.

    The time of this thread alone, beside it, tells what is the tick's cost and what the other processes'.
    """
    highway = SCENARIOS["highway"]
    crowded = replace(
        highway,
        name="highway-crowded",
        flows=tuple(
            replace(flow, count=(round(TICK_CARS * flow.count[0]), round(TICK_CARS * flow.count[1])))
            for flow in highway.flows
        ),
    )
    SCENARIOS[crowded.name] = crowded  # in this process alone
    try:
        node = SimNode(SimConfig(scenario=crowded.name, density=2.0))
    finally:
        del SCENARIOS[crowded.name]
    node.reset(0)
    warm_up, vehicles, took, used = 50, [], [], []
    for k in range(warm_up + ticks):
        action = Action(
            epoch=node.epoch,
            stamp_ns=0,
            answers_tick=node.tick,
            source="policy",
            meta_action=k % 5 if k % 8 == 0 else int(MetaAction.CRUISE),
        )
        vehicles.append(len(node._env.road.vehicles))
        cpu, start = time.thread_time_ns(), time.monotonic_ns()
        node.step(action, start)
        took.append(time.monotonic_ns() - start)
        used.append(time.thread_time_ns() - cpu)
    cpu_p99_us = round(float(np.percentile(used[warm_up:], 99)) / 1000.0, 1)
    return point_of(min(vehicles), took[warm_up:], cpu_p99_us=cpu_p99_us, limit_us=1000.0 * TICK_MS)
