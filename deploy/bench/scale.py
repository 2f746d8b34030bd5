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
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from deploy.bench.latency_results import DEADLINE_US
from deploy.bench.machine import host
from deploy.bench.pingpongs import PingPongs
from deploy.bench.progress import MeasurementError, say
from deploy.bench.scale_fast_node import egos, observed, vehicles
from deploy.bench.scale_points import Point, breaking_point, point_of
from deploy.bench.scale_simulators import simulator_tick, simulators
from deploy.lab.picture import picture
from schemas.runtime.realtime import Mode
from schemas.wire import topics

SCHEMA = "fastslow.scale/3"
SIZES = (128, 512, 1024, 2048, 3072, 8192, 16_384, 32_768, 49_152, 57_344, 65_536, 98_304)
TITLES = {
    "vehicles": "vehicles observed by the deployed fast node",
    "egos": "egos, batched compute in one process: no bus, normal priority",
    "simulators": "pairs of simulator and fast node at 15 Hz on one bus: one router, a direct link in each pair",
    "routed": "the same without the direct links: every tick passes the router",
    "message_bytes": "message size over the bare low-latency link",
}
SILENCE_S = 3.0
"""A payload that has not arrived after this long has been lost."""


def sizes(folder: Path, realtime: Mode, rounds: int) -> list[Point]:
    """By message size, up to the first that gets lost."""
    points: list[Point] = []
    for size in SIZES:
        with PingPongs(folder, ("bus",), size, 128, realtime, patience_s=SILENCE_S) as peers:
            reply = None
            if "bus" in peers.names:
                peers.order("bus", "rounds", rounds)
                reply = peers.reply("bus")
        if reply is None:
            why = peers.lost["bus"]
            lost = "lost without an error: the low-latency transport does not fragment"
            points.append({"x": size, "breaks": lost if "did not answer" in why else why})
            break
        points.append(point_of(size, reply[0]))
    return points


def run(realtime: Mode, rounds: int, seconds: float, out: Path | None) -> tuple[dict[str, Any], Path]:
    """Measure, save and return the curves and where they are.

    Raises `ConfigError` or `MeasurementError` if nothing starts.
    """
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
        except MeasurementError as lost:
            say(f"bench: without {name}: {lost}")
            curves[name] = []
    say("bench: the simulator's own tick")
    result = {
        "schema": SCHEMA,
        "host": machine,
        "codec_limit_bytes": topics.MAX_MESSAGE_BYTES,
        "simulator_tick": simulator_tick(max(1000, rounds)),
        "curves": {
            name: {"what": TITLES[name], "points": points, "knee": breaking_point(points)}
            for name, points in curves.items()
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
    """The curves as a picture: p50 and p99 over each quantity, on logarithmic axes, and where each breaks."""
    curves = result["curves"]
    with picture(path, 1, len(curves), figsize=(4 * len(curves), 3.6), sharey=True) as (_, axes):
        for axis, (name, curve) in zip(axes[0], curves.items(), strict=True):
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
            axis.axhline(DEADLINE_US / 1000.0, color="grey", linestyle=":")
            axis.set(xscale="log", yscale="log", xlabel=name.replace("_", " "))
        axes[0][0].set_ylabel("time [ms]")
        axes[0][0].legend()
