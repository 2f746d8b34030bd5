"""`fastslow bench scale`: how the cost of a tick grows with vehicles, egos, loops on one machine and message size."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from os import getpid
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from deploy.bench import figures
from deploy.bench.latency import PERIOD_NS, Deployment, Peers, host, say
from schemas import topics
from schemas.codec import Fault, decode, encode, rows_of
from schemas.messages import Observation
from schemas.process import ConfigError
from schemas.realtime import Mode

SCHEMA = "fastslow.scale/1"
VEHICLES = (5, 10, 20, 40, 60, 80, 100, 150, 200)
EGOS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
LOOPS = (1, 2, 4, 8, 16)
SIZES = (128, 512, 1024, 2048, 3072, 8192, 16_384, 32_768, 49_152, 65_536, 98_304)
SILENCE_S = 3.0
"""A payload that has not arrived after this long has been lost."""


def crowd(seen: Observation, vehicles: int) -> Observation:
    """An observation of the same road with this many vehicles, the ego among them."""
    ego = rows_of(seen)[:1]
    rows = np.repeat(ego, vehicles, axis=0)
    others = np.arange(1, vehicles)
    rows[1:, 0] = others
    rows[1:, 1] += np.where(others % 2, 1, -1) * (12.0 + 8.0 * (others // 2))
    return msgspec.structs.replace(seen, rows=rows.tobytes())


def _point(x: int, took_ns: list[int], **more: object) -> dict[str, Any]:
    p50, p99 = (round(float(p) / 1000.0, 1) for p in np.percentile(took_ns, (50, 99)))
    return {"x": x, "n": len(took_ns), "p50_us": p50, "p99_us": p99, **more}


def vehicles(folder: Path, realtime: Mode, rounds: int) -> tuple[list[dict[str, Any]], Observation]:
    """Back-to-back round trips of the real fast node by vehicles observed, and an observation of the real simulator."""
    with Deployment(folder, realtime, "slow", "llm", trace=False) as system:
        system.ready()
        while system.newest is None:
            system.step()
            time.sleep(0.02)
        seen = system.newest
    points: list[dict[str, Any]] = []
    with ExitStack() as stack:
        system = stack.enter_context(Deployment(folder, realtime, "sim", "slow", "llm", trace=False))
        system.ready()
        peers = stack.enter_context(Peers(folder, (), 0, 0, realtime))
        peers.join_ours(system, encode(seen))
        orders = peers.orders["ours"]
        for n in VEHICLES:
            try:
                payload = encode(crowd(seen, n))
            except Fault as fault:
                points.append({"x": n, "breaks": str(fault)})
                continue
            orders.send(("observe", payload))
            orders.send(("rounds", rounds))
            while not orders.poll(0.02):
                system.step()
            points.append(_point(n, orders.recv()[0], bytes=len(payload)))
    return points, seen


class _Prepared:
    """A policy whose answer is known already; keeps what it was asked."""

    def __init__(self, policy: Any) -> None:
        self.weights, self.sidecar = policy.weights, policy.sidecar
        self.asked: Any = None
        self.answer: Any = None

    def logits(self, x: Any) -> Any:
        self.asked = x
        return self.answer


def egos(seen: Observation, rounds: int) -> list[dict[str, Any]]:
    """What one process needs to answer so many egos: decode, step and encode each, with one inference for all.

    In this process and without the bus: the deployed fast node serves one ego. Ends where p99 exceeds the deadline.
    """
    from fast_node.config import FastConfig
    from fast_node.node import FastNode
    from fast_node.policy import load_policy

    policy, payload = load_policy(), encode(seen)
    points: list[dict[str, Any]] = []
    for n in EGOS:
        prepared = [_Prepared(policy) for _ in range(n)]
        nodes = [FastNode(FastConfig(), one) for one in prepared]  # type: ignore[arg-type]
        took: list[int] = []
        for k in range(max(100, rounds // n) + 5):
            start = time.monotonic_ns()
            if k:
                for one, answer in zip(prepared, policy.logits(np.stack([p.asked for p in prepared])), strict=True):
                    one.answer = answer
            for node, one in zip(nodes, prepared, strict=True):
                action, _ = node.step(decode(topics.OBSERVATION, payload), None, start)
                encode(action)
                if one.asked is None:
                    raise ConfigError("the fast node does not ask its policy for logits")
            took.append(time.monotonic_ns() - start)
        points.append(_point(n, took[5:]))
        if points[-1]["p99_us"] > figures.DEADLINE_US:
            break
    return points


def loops(folder: Path, realtime: Mode, seconds: float) -> list[dict[str, Any]]:
    """Round trips of the bare bus at 15 Hz, with so many pairs of processes on this machine, evenly out of phase."""
    points: list[dict[str, Any]] = []
    n = round(seconds * 15)
    for pairs in LOOPS:
        with ExitStack() as stack:
            ends = [stack.enter_context(Peers(folder, ("bus",), 1024, 256, realtime)).orders["bus"]
                    for _ in range(pairs)]
            first = time.monotonic_ns() + 200_000_000
            for i, orders in enumerate(ends):
                orders.send(("paced", first + i * PERIOD_NS // pairs, PERIOD_NS, n))
            points.append(_point(pairs, [ns for orders in ends for ns in orders.recv()[0]]))
    return points


def sizes(folder: Path, realtime: Mode, rounds: int) -> list[dict[str, Any]]:
    """Back-to-back round trips of the bare bus by message size, far beyond what our topics allow."""
    points: list[dict[str, Any]] = []
    for size in SIZES:
        try:
            with Peers(folder, ("bus",), size, 128, realtime, patience_s=SILENCE_S) as peers:
                peers.orders["bus"].send(("rounds", rounds))
                points.append(_point(size, peers.orders["bus"].recv()[0]))
        except ConfigError:
            points.append({"x": size, "breaks": "lost without an error: the low-latency transport does not fragment"})
    return points


def knee(points: list[dict[str, Any]]) -> dict[str, Any]:
    """The last point that still works with p99 within the deadline, and what is wrong with the first that does not."""
    held: int | None = None
    for point in points:
        if "breaks" in point:
            return {"holds": held, "then": point["breaks"]}
        if point["p99_us"] > figures.DEADLINE_US:
            return {"holds": held, "then": f"p99 of {point['p99_us'] / 1000.0:.1f} ms exceeds the deadline"}
        held = point["x"]
    return {"holds": held, "then": "nothing broke in this range"}


def run(realtime: Mode, rounds: int, seconds: float, out: Path | None) -> tuple[dict[str, Any], Path]:
    """Measure, save and return the curves and where they are. Raises `ConfigError` if something does not start."""
    folder = out or Path("runs") / f"scale-{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{getpid()}"
    folder.mkdir(parents=True, exist_ok=True)
    machine = host(realtime)
    say("bench: vehicles observed")
    by_vehicles, seen = vehicles(folder, realtime, rounds)
    parts: list[tuple[str, str, Callable[[], list[dict[str, Any]]]]] = [
        ("egos", "egos answered by one process", lambda: egos(seen, rounds)),
        ("loops", "15 Hz loops on this machine", lambda: loops(folder, realtime, seconds)),
        ("message_bytes", "message size", lambda: sizes(folder, realtime, rounds)),
    ]
    curves = {"vehicles": by_vehicles}
    for name, title, measure in parts:
        say(f"bench: {title}")
        curves[name] = measure()
    result = {"schema": SCHEMA, "host": machine,
              "curves": {name: {"points": points, "knee": knee(points)} for name, points in curves.items()}}
    path = folder / "scale.json"
    path.write_text(json.dumps(result) + "\n", encoding="utf-8")
    return result, path


def lines(result: dict[str, Any]) -> Iterator[str]:
    """The result for people."""
    for name, curve in result["curves"].items():
        yield f"{name:>13} {'n':>7} {'p50':>9} {'p99':>9}   (us)"
        for point in curve["points"]:
            if "breaks" in point:
                yield f"{point['x']:>13} {point['breaks']}"
            else:
                yield f"{point['x']:>13} {point['n']:>7} {point['p50_us']:>9.0f} {point['p99_us']:>9.0f}"
        yield f"  holds up to {curve['knee']['holds']}; {curve['knee']['then']}"
