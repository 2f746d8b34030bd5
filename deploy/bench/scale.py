"""`fastslow bench scale`: how a tick's cost grows with vehicles, egos, simulators and message size; what breaks.

* vehicles: observations with so many vehicles to the real fast node, back to back, with the parts of its tick; and its
  step alone in this process, which goes on where the message no longer fits. A crowd stands still around the ego.
* egos: what one process needs to compute the answers to so many at once: decode, step and encode each, one inference
  for all. In this process, without a bus and at normal priority: the deployed fast node serves one ego.
* simulators: real simulators at 15 Hz, each with a real fast node, on one bus: all are linked to one router, each
  pair in a namespace of its own and with a direct link between its nodes, as deployed. They start when they are ready,
  so their phases are what they happen to be. As a plain user the pairs are spread over the cores, both nodes of one on
  one core.
* routed: the same without the direct links, so that every tick passes the router, a thread at normal priority.
* message_bytes: bare round trips over the low-latency link, far beyond what our topics allow.

Beside the curves: the simulator's own tick among 50 vehicles, in this process, without a bus and at normal priority.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from deploy.bench import figures
from deploy.bench.contenders import START_S, Child, Deployment, Lost, Peers, children, say, trace_of
from deploy.bench.latency import PERIOD_NS, host
from schemas.runtime.bus import BusConfig, open_bus
from schemas.runtime.realtime import Mode, resolve
from schemas.wire import topics
from schemas.wire.codec import Fault, decode, encode, rows_of
from schemas.wire.messages import Action, MetaAction, Observation

SCHEMA = "fastslow.scale/3"
VEHICLES = (5, 10, 20, 40, 60, 80, 100, 150, 200)
EGOS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512)
PAIRS = (1, 2, 4, 8, 16, 32, 48, 64)
SIZES = (128, 512, 1024, 2048, 3072, 8192, 16_384, 32_768, 49_152, 57_344, 65_536, 98_304)
PARTS = ("decode", "mask", "features", "policy", "rest of the step", "encode and put")
TITLES = {
    "vehicles": "vehicles observed by the deployed fast node",
    "egos": "egos, batched compute in one process: no bus, normal priority",
    "simulators": "pairs of simulator and fast node at 15 Hz on one bus: one router, a direct link in each pair",
    "routed": "the same without the direct links: every tick passes the router",
    "message_bytes": "message size over the bare low-latency link",
}
TICK_CARS = 2.5
"""Times the cars of our highway: 50 and a few."""
TICK_MS = 5.0
"""What the simulator's tick may take at p99."""
SETTLE_S = 1.0
SILENCE_S = 3.0
"""A payload that has not arrived after this long has been lost."""
Point = dict[str, Any]


def crowd(seen: Observation, vehicles: int) -> Observation:
    """An observation of the same road with this many vehicles, the ego among them, as epoch `vehicles`."""
    ego = rows_of(seen)[:1]
    rows = np.repeat(ego, vehicles, axis=0)
    others = np.arange(1, vehicles)
    rows[1:, 0] = others
    rows[1:, 1] += np.where(others % 2, 1, -1) * (12.0 + 8.0 * (others // 2))
    return msgspec.structs.replace(seen, rows=rows.tobytes(), epoch=vehicles)


def _point(x: int, took_ns: Sequence[int], **more: object) -> Point:
    p50, p99 = (round(float(p) / 1000.0, 1) for p in np.percentile(took_ns, (50, 99)))
    return {"x": x, "n": len(took_ns), "p50_us": p50, "p99_us": p99, **more}


def observed(folder: Path, realtime: Mode) -> Observation:
    """What the real simulator publishes. Raises `Lost`."""
    with Deployment(folder, realtime, "slow", "llm", trace=False) as system:
        system.ready()
        system.until(lambda: system.newest is not None, "the first tick")
        assert system.newest is not None
        return system.newest


def vehicles(folder: Path, realtime: Mode, rounds: int, seen: Observation) -> list[Point]:
    """By vehicles observed: message size, the step alone, and while it fits the round trip with its parts."""
    points: list[Point] = []
    with ExitStack() as stack:
        system = stack.enter_context(Deployment(folder, realtime, "sim", "slow", "llm", trace=True))
        system.ready()
        peers = stack.enter_context(Peers(folder, (), 0, 0, realtime))
        peers.join_ours(system, encode(seen))
        for n in sorted({*VEHICLES, _most_vehicles(seen)}):
            observation = crowd(seen, n)
            about = {"bytes": len(msgspec.msgpack.encode(observation)), "step_us": _step_us(observation)}
            try:
                peers.order("ours", "observe", encode(observation))
            except Fault as fault:
                points.append({"x": n, "breaks": str(fault), **about})
                continue
            peers.order("ours", "rounds", rounds)
            reply = peers.reply("ours", system.step)
            if reply is None:
                raise Lost(peers.lost["ours"])
            points.append(_point(n, reply[0], **about))
    stamps = trace_of(folder / "fast.trace")
    for point in points:
        rows = stamps[stamps[:, 0] == point["x"]]
        if len(rows):
            point["parts_us"] = _parts_us(rows)
    return points


def _most_vehicles(seen: Observation) -> int:
    """How many fit in a message."""
    most = max(VEHICLES)
    while len(msgspec.msgpack.encode(crowd(seen, most))) > topics.MAX_MESSAGE_BYTES:
        most -= 1
    return most


def _parts_us(rows: Any) -> dict[str, float]:
    """Medians [us] from the fast node's own stamps."""
    arrived, decoded, mask, features, policy, stepped, put = rows[:, 2:].T
    parts = (decoded - arrived, mask, features, policy, stepped - decoded - mask - features - policy, put - stepped)
    return {name: round(float(np.median(ns)) / 1000.0, 1) for name, ns in zip(PARTS, parts, strict=True)}


def _step_us(observation: Observation, rounds: int = 200) -> float:
    """Median time of the fast node's step in this process: mask, features, policy, choice [us]."""
    from fast_node.config import FastConfig
    from fast_node.node import FastNode
    from fast_node.policies.attention import load_policy

    node, took = FastNode(FastConfig(), load_policy()), []
    for _ in range(rounds):
        start = time.monotonic_ns()
        node.step(observation, None, start)
        took.append(time.monotonic_ns() - start)
    return round(float(np.median(took)) / 1000.0, 1)


class _Prepared:
    """A policy whose answer is known already; keeps what it was asked."""

    def __init__(self) -> None:
        self.asked: Any = None
        self.answer: Any = np.zeros(5, np.float32)

    def logits(self, x: Any) -> Any:
        self.asked = x
        return self.answer


def egos(seen: Observation, rounds: int) -> list[Point]:
    """By egos answered at once, up to the largest number whose p99 holds the deadline, within 5 %."""
    points: list[Point] = []
    for n in EGOS:
        points.append(_egos(seen, n, rounds))
        if broken(points[-1]):
            break
    else:
        return points
    holds, breaks = (points[-2]["x"] if len(points) > 1 else 0), points[-1]["x"]
    while breaks - holds > max(1, breaks // 20):
        points.append(_egos(seen, (holds + breaks) // 2, rounds))
        if broken(points[-1]):
            breaks = points[-1]["x"]
        else:
            holds = points[-1]["x"]
    return sorted(points, key=lambda point: int(point["x"]))


def _egos(seen: Observation, n: int, rounds: int) -> Point:
    from fast_node.config import FastConfig
    from fast_node.node import FastNode
    from fast_node.policies.attention import load_policy

    policy, payload = load_policy(), encode(seen)
    asked = [_Prepared() for _ in range(n)]
    nodes = [FastNode(FastConfig(), one) for one in asked]  # type: ignore[arg-type]
    took: list[int] = []
    for k in range(max(200, rounds // n) + 5):
        start = time.monotonic_ns()
        if k:
            for one, answer in zip(asked, policy.logits(np.stack([p.asked for p in asked])), strict=True):
                one.answer = answer
        for node in nodes:
            encode(node.step(decode(topics.OBSERVATION, payload), None, start)[0])
        took.append(time.monotonic_ns() - start)
    return _point(n, took[5:])


def simulators(folder: Path, realtime: Mode, seconds: float, *, direct: bool) -> list[Point]:
    """By pairs of simulator and fast node on one bus, up to the first number that breaks. `direct`: linked in pairs."""
    points: list[Point] = []
    for pairs in PAIRS:
        try:
            points.append(_pairs(folder, realtime, seconds, pairs, direct=direct))
        except Lost as lost:
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

            def node(module: str, i: int, *, listens: bool = False, **config: object) -> Child:
                link = [f"unixsock-stream/{sockets}/{i}.sock"] if direct else []
                bus = {
                    "mode": "peer" if direct else "client",
                    "listen": link if listens else [],
                    "connect": [router, *([] if listens else link)],
                    "namespace": f"car-{i}",
                    "low_latency": True,
                }
                with _room(realtime, i):
                    return start(
                        f"{module} {i}",
                        folder / f"{module}-{i}.log",
                        sys.executable,
                        "-m",
                        module,
                        json.dumps({"bus": bus, "realtime": realtime, **config}),
                    )

            nodes = [node("fast_node", i, listens=True) for i in range(pairs)]
            _ready(nodes)
            nodes += [node("sim_node", i, seed=i, trace=f"{sockets}/{i}.trace") for i in range(pairs)]
            _ready(nodes)
            time.sleep(SETTLE_S)
            idle_s, first = _idle_s(), time.monotonic_ns()
            time.sleep(seconds)
            ends = time.monotonic_ns()
            idle_s = _idle_s() - idle_s
            _ready(nodes)
        for i in range(pairs):
            one, late = _round_trips(Path(sockets) / f"{i}.trace", first, ends)
            took, skipped = took + one, skipped + late
    late = sum(ns > 1000 * figures.DEADLINE_US for ns in took)
    busy = round(1.0 - idle_s / (seconds * (os.cpu_count() or 1)), 2)
    return _point(pairs, took, misses=late + skipped, cores_busy=busy)


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


def _ready(nodes: Sequence[Child]) -> None:
    """Wait until all have said so. Raises `Lost` if one has ended or does not."""
    limit_s = START_S + 2.0 * len(nodes)  # they all start at once, on few cores
    deadline = time.monotonic() + limit_s
    waiting = list(nodes)
    while waiting:
        if why := next(filter(None, (node.trouble() for node in nodes)), ""):
            raise Lost(why)
        if time.monotonic() > deadline:
            raise Lost(f"{waiting[0].name} is not ready after {limit_s:g} s{waiting[0].last_line()}")
        waiting = [node for node in waiting if b'"ready"' not in node.log.read_bytes()]
        time.sleep(0.05)


def _round_trips(trace: Path, first: int, ends: int) -> tuple[list[int], int]:
    """Round trips [ns] of the ticks published within first..ends, a whole period if unanswered, and skipped ticks."""
    sent, answered, due, _, next_due, after = trace_of(trace).T[2:8]
    within = (first <= sent) & (sent < ends)
    took = np.where(answered >= 0, answered, np.maximum(PERIOD_NS, after - sent))[within]
    skipped = np.rint((next_due - due)[within] / PERIOD_NS).astype(int) - 1
    return took.tolist(), int(skipped.clip(0).sum())


def _idle_s() -> float:
    """What all cores together have idled since the machine's start (Linux; elsewhere 0)."""
    try:
        fields = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
    except OSError:
        return 0.0
    return (int(fields[4]) + int(fields[5])) / os.sysconf("SC_CLK_TCK")


def sizes(folder: Path, realtime: Mode, rounds: int) -> list[Point]:
    """By message size, up to the first that gets lost."""
    points: list[Point] = []
    for size in SIZES:
        with Peers(folder, ("bus",), size, 128, realtime, patience_s=SILENCE_S) as peers:
            reply = None
            if "bus" in peers.names:
                peers.order("bus", "rounds", rounds)
                reply = peers.reply("bus")
        if reply is None:
            why = peers.lost["bus"]
            lost = "lost without an error: the low-latency transport does not fragment"
            points.append({"x": size, "breaks": lost if "did not answer" in why else why})
            break
        points.append(_point(size, reply[0]))
    return points


def simulator_tick(ticks: int) -> Point:
    """The simulator's own tick, from an action to an observation, among some 50 vehicles; `x`: the fewest there were.

    The time of this thread alone, beside it, tells what is the tick's cost and what the other processes'.
    """
    from sim_node.config import SimConfig
    from sim_node.node import SimNode
    from sim_node.scenarios import SCENARIOS

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
    return _point(min(vehicles), took[warm_up:], cpu_p99_us=cpu_p99_us, limit_us=1000.0 * TICK_MS)


def broken(point: Point) -> str:
    """What is wrong with a point; empty if p99 holds the deadline and nothing is missed."""
    if "breaks" in point:
        return str(point["breaks"])
    if point["p99_us"] > figures.DEADLINE_US:
        return f"p99 of {point['p99_us'] / 1000.0:.1f} ms exceeds the deadline"
    return f"{point['misses']} of {point['n']} ticks missed" if point.get("misses") else ""


def knee(points: Sequence[Point]) -> dict[str, Any]:
    """The last point that holds, the first that does not, and what is wrong with that one."""
    holds: int | None = None
    for point in points:
        if why := broken(point):
            return {"holds": holds, "breaks_at": point["x"], "then": why}
        holds = point["x"]
    return {"holds": holds, "breaks_at": None, "then": "nothing broke in this range"}


def run(realtime: Mode, rounds: int, seconds: float, out: Path | None) -> tuple[dict[str, Any], Path]:
    """Measure, save and return the curves and where they are. Raises `ConfigError` or `Lost` if nothing starts."""
    folder = out or Path("runs") / f"scale-{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}"
    folder.mkdir(parents=True, exist_ok=True)
    machine = host(realtime)
    seen = observed(folder, realtime)
    parts: dict[str, Callable[[], list[Point]]] = {
        "vehicles": lambda: vehicles(folder, realtime, rounds, seen),
        "egos": lambda: egos(seen, rounds),
        "simulators": lambda: simulators(folder, realtime, seconds, direct=True),
        "routed": lambda: simulators(folder, realtime, seconds, direct=False),
        "message_bytes": lambda: sizes(folder, realtime, rounds),
    }
    curves: dict[str, list[Point]] = {}
    for name, measure in parts.items():
        say(f"bench: {TITLES[name]}")
        try:
            curves[name] = measure()
        except Lost as lost:
            say(f"bench: without {name}: {lost}")
            curves[name] = []
    say("bench: the simulator's own tick")
    result = {
        "schema": SCHEMA,
        "host": machine,
        "codec_limit_bytes": topics.MAX_MESSAGE_BYTES,
        "simulator_tick": simulator_tick(max(1000, rounds)),
        "curves": {
            name: {"what": TITLES[name], "points": points, "knee": knee(points)} for name, points in curves.items()
        },
    }
    path = folder / "scale.json"
    path.write_text(json.dumps(result) + "\n", encoding="utf-8")
    return result, path


def lines(result: dict[str, Any]) -> Iterator[str]:
    """The result for people."""
    machine, tick = result["host"], result["simulator_tick"]
    yield (
        f"{machine['cpu']}, {machine['cores']} cores, {machine['kernel']}, scheduling: {machine['realtime']}, "
        f"load average {machine['load_average'][0]:g} at the start"
    )
    for name, curve in result["curves"].items():
        yield curve["what"]
        yield f"{name:>13} {'n':>7} {'p50':>9} {'p99':>9}   (us)"
        for point in curve["points"]:
            times = f"{point['n']:>7} {point['p50_us']:>9.0f} {point['p99_us']:>9.0f}" if "n" in point else " " * 27
            yield f"{point['x']:>13} {times}   {_remarks(point)}".rstrip()
        yield f"  holds up to {curve['knee']['holds']}; {curve['knee']['then']}"
    verdict = "reached" if tick["p99_us"] <= tick["limit_us"] else "MISSED"
    yield (
        f"the simulator's own tick, {tick['x']} vehicles, one process, no bus, normal priority: p50 "
        f"{tick['p50_us'] / 1000.0:.2f}, p99 {tick['p99_us'] / 1000.0:.2f} ms of {tick['n']} (of its own CPU time "
        f"p99 {tick['cpu_p99_us'] / 1000.0:.2f}); {verdict}: p99 <= {tick['limit_us'] / 1000.0:g} ms"
    )
    yield f"the codec refuses more than {result['codec_limit_bytes']} bytes on our topics"


def _remarks(point: Point) -> str:
    said = [f"{point['bytes']} bytes, step alone {point['step_us']:.0f}"] if "bytes" in point else []
    said += [f"{name} {us:.0f}" for name, us in point.get("parts_us", {}).items()]
    if "misses" in point:
        said.append(f"misses {point['misses']}, cores {100 * point['cores_busy']:.0f} % busy")
    if "breaks" in point:
        said.append(point["breaks"])
    return ", ".join(said)


def plot(result: dict[str, Any], path: Path) -> None:
    """The curves as a picture: p50 and p99 over each quantity, on logarithmic axes, with the knee."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(result["curves"]), figsize=(4 * len(result["curves"]), 3.6), sharey=True)
    for axis, (name, curve) in zip(axes, result["curves"].items(), strict=True):
        measured = [point for point in curve["points"] if "n" in point]
        for figure_name in ("p50_us", "p99_us"):
            axis.plot(
                [p["x"] for p in measured],
                [p[figure_name] / 1000.0 for p in measured],
                "o-",
                markersize=3,
                label=figure_name[:3],
            )
        if curve["knee"]["breaks_at"] is not None:
            axis.axvline(curve["knee"]["breaks_at"], color="red", linestyle="--", label="breaks")
        axis.axhline(figures.DEADLINE_US / 1000.0, color="grey", linestyle=":")
        axis.set(xscale="log", yscale="log", xlabel=name.replace("_", " "))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("time [ms]")
    axes[0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
