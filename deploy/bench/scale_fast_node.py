"""How the fast node's cost grows: with the vehicles that it observes, and with the egos that it answers."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from deploy.bench.deployed_system import Deployment, trace_of
from deploy.bench.latency_samples import ASKED
from deploy.bench.pingpongs import PingPongs
from deploy.bench.progress import MeasurementError
from deploy.bench.scale_points import Point, broken, point_of
from fast_node.config import FastConfig
from fast_node.node import FastNode
from fast_node.policies.attention import load_attention
from schemas.driving.road import ID, X
from schemas.runtime.realtime import Mode
from schemas.wire import topics
from schemas.wire.codec import Fault, decode, encode, rows_of
from schemas.wire.messages import Observation

VEHICLES = (5, 10, 20, 40, 60, 80, 100, 150, 200)
EGOS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512)
PARTS = ("decode", "mask", "features", "policy", "rest of the step", "encode and put")


def crowd(seen: Observation, vehicles: int) -> Observation:
    """An observation of the same road with this many vehicles, the ego among them, as epoch `vehicles`."""
    ego = rows_of(seen)[:1]
    rows = np.repeat(ego, vehicles, axis=0)
    others = np.arange(1, vehicles)
    rows[1:, ID] = others
    rows[1:, X] += np.where(others % 2, 1, -1) * (12.0 + 8.0 * (others // 2))
    return msgspec.structs.replace(seen, rows=rows.tobytes(), epoch=vehicles)


def observed(folder: Path, realtime: Mode) -> Observation:
    """What the real simulator publishes. Raises `MeasurementError`."""
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
        peers = stack.enter_context(PingPongs(folder, (), 0, 0, realtime))
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
                raise MeasurementError(peers.lost["ours"])
            points.append(point_of(n, reply[0], **about))
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
    """Medians [us] from the fast node's own stamps; of features and policy over the ticks with a decision."""
    arrived, decoded, mask, features, policy, stepped, put = rows[:, 2:].T
    parts = (decoded - arrived, mask, features, policy, stepped - decoded - mask - features - policy, put - stepped)
    took = {name: ns[ns != 0] if name in ASKED else ns for name, ns in zip(PARTS, parts, strict=True)}
    return {name: round(float(np.median(ns)) / 1000.0, 1) for name, ns in took.items() if len(ns)}


def _step_us(observation: Observation, rounds: int = 200) -> float:
    """Median time of the fast node's step in this process: mask, features, policy, choice [us]."""
    node, took = FastNode(FastConfig(), load_attention()), []
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
    policy, payload = load_attention(), encode(seen)
    asked = [_Prepared() for _ in range(n)]
    nodes = [FastNode(FastConfig(), one) for one in asked]
    took: list[int] = []
    for k in range(max(200, rounds // n) + 5):
        start = time.monotonic_ns()
        if k:
            for one, answer in zip(asked, policy.logits(np.stack([p.asked for p in asked])), strict=True):
                one.answer = answer
        for node in nodes:
            encode(node.step(decode(topics.OBSERVATION, payload), None, start)[0])
        took.append(time.monotonic_ns() - start)
    return point_of(n, took[5:])
