"""What is made of a latency run: promised figures, what they include, and the text for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from typing import Any, cast

from deploy.bench.latency_results import Row, table
from deploy.bench.loads import LOADS
from deploy.bench.transports import TRANSPORTS
from schemas.runtime.realtime import Mode, resolve

SOAK_TICKS = 13_500
"""15 minutes."""
DISTURBED = 1.25
"""An idle p99 this many times a load's tells of something else that kept the machine busy."""


def targets(
    rows: Sequence[Row], fast: dict[str, object], realtime: Mode, age_us: Mapping[str, float] | None = None
) -> list[dict[str, object]]:
    """The figures that were promised, those of them that this run has. `valid` is false, and `note` says why, where a
    figure cannot be judged; it is not reached then. age_us: of the applied actions without a load, p50 and p99."""
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
        watched = by.get(("ours", "watched", "15hz"))
        if watched is not None:
            check("paced p50, load watched / none", watched.p50_us / ours.p50_us, 1.1)
            check("paced p99, load watched / none", watched.p99_us / ours.p99_us, 1.1)
            check("missed deadlines more, load watched", float(watched.misses - ours.misses), 0.0)
        for pace in ("15hz", "back-to-back"):
            dora = by.get(("dora", "none", pace))
            for what in ("bus", "ours"):
                mine = by.get((what, "none", pace))
                if dora is not None and mine is not None:
                    check(f"p50 {pace}, dora / {what}", dora.p50_us / mine.p50_us, 4.0, at_least=True)
    bus = by.get(("bus", "none", "15hz"))
    if age_us is not None:
        if bus is not None:
            check("age of the applied action p50 / bare zenoh", age_us["p50"] / bus.p50_us, 1.5)
            check("age of the applied action p99 / bare zenoh", age_us["p99"] / bus.p99_us, 1.5)
        check("age of the applied action p99 [ms]", age_us["p99"] / 1000.0, 20.0)
    soak = by.get(("ours", "llm", "15hz"))
    if soak is not None and soak.n + soak.misses >= SOAK_TICKS:  # n alone lacks the skipped ticks, which are misses
        check(f"missed deadlines of {soak.n} ticks, load llm", float(soak.misses), 0.0)
    check("fast node, start to first action [s]", cast("float | None", fast.get("first_action_s")), 0.5)
    check("fast node, resident memory [MB]", cast("float | None", fast.get("rss_mb")), 100.0)
    return found


def bus_paced_minus_back_to_back(rows: Sequence[Row]) -> dict[str, float]:
    """By load: p50 of the bare bus at 15 Hz minus p50 of the bare bus back to back [us].

    Mostly what it costs to wake two processes that slept, with cold caches. It says nothing of ours, which under
    SCHED_FIFO polls for what is about to come, while the bus participant sleeps.
    """
    bus = {(row.load, row.pace): row.p50_us for row in rows if row.what == "bus"}
    return {
        load: round(bus[load, "15hz"] - bus[load, "back-to-back"], 1)
        for load in LOADS
        if {(load, "15hz"), (load, "back-to-back")} <= bus.keys()
    }


def included(whats: Set[str]) -> list[str]:
    """What the figures of these participants are made of, and what counts as a miss."""
    bare = ", ".join(peer for peer in TRANSPORTS if peer in whats - {"floor"})
    said = {
        "ours": "ours: from just before sim encodes and publishes an observation until sim has decoded the action that "
        "answers it, over the bus as deployed (supervisor's router, slow node, 5 Hz heartbeats). The "
        "simulator's step comes after; the age of the applied action lasts until it begins. Under "
        "SCHED_FIFO with a second core, sim and fast poll for what is about to come, while the bare transports "
        "sleep until it is there. Back to back: a recorded observation is replayed to the real fast node, "
        "since the simulator's own step would lie between.",
        "floor": "floor: a Unix-socket ping-pong of the same payload sizes, plus one bare policy inference in a warm "
        "loop.",
        bare: f"{bare}: a ping-pong of the same payload sizes, with nothing done to the payloads.",
    }
    return [
        *(text for what, text in said.items() if what and (what == bare or what in whats)),
        "Paced, each participant has its own slice of the 66.7 ms. All have the same scheduling class. A miss of "
        "ours: the answer came more than 20 ms after the publication, or never, or the publication itself was more "
        "than one period after the tick was due, or the tick was skipped. A miss of the others: the answer came "
        "more than 20 ms after the sending; a round whose predecessor was late counts from when it was due.",
    ]


def lines(result: dict[str, Any]) -> Iterator[str]:
    """The result for people."""
    machine = result["host"]
    yield (
        f"{machine['cpu']}, {machine['cores']} cores, {machine['kernel']}, scheduling: {machine['realtime']}, "
        f"load average {machine['load_average'][0]:g} at the start"
    )
    versions = {**machine["versions"], "commit": machine["revision"]}
    yield ", ".join(f"{name} {number}" for name, number in versions.items() if number)
    yield from table(result["rows"])
    for row in result["absent"]:
        yield f"{row['load']:<7} {row['pace']:<13} {row['what']:<12} absent: {row['why']}"
    for load, paced in result["loads"].items():
        if paced["load"]:
            yield f"load {load}: " + ", ".join(f"{name} {value:g}" for name, value in paced["load"].items())
        yield f"scheduling, load {load}: " + ", ".join(f"{name} {said}" for name, said in paced["scheduling"].items())
        yield (f"sent after it was due, load {load}, p50/p99 us: {_p50s(paced['timer_late_us'])} (ours: published)")
        if load in result["parts_us"]:
            yield f"parts of ours, load {load}, p50/p99 us: {_p50s(result['parts_us'][load])}"
        if paced["applied_age_us"] is not None:
            age = {"age of the applied actions": paced["applied_age_us"]}
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
