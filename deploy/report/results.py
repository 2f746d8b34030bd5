"""Figures of results: who succeeds how often, how a learner's return grows, how long the loop takes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deploy.bench.latency_results import DEADLINE_US, centres, key_of
from deploy.lab.picture import colour_of, picture
from deploy.lab.study.report import plot
from deploy.record.reader import Recording
from deploy.report.figure import Figure, Table
from deploy.report.inputs import Successes, name_of
from schemas.wire.messages import Action, Observation, Status

ROUND_TRIP, AGE, ANSWERED = "round trip", "age of the applied action", "until it is decided"
STYLES = {ROUND_TRIP: ("#3b82c4", "-"), AGE: ("#d62f3f", "-"), ANSWERED: ("#8a8f98", "--")}


def success_figure(rows: Sequence[Successes], name: str, title: str) -> Figure:
    """Bars with intervals: a group per road, a bar per driver."""
    table = Table(
        ("road", "driver", "episodes", "success", "95 % interval", "ride score (95 %)", "own fault"),
        [
            (
                row.road,
                row.driver,
                str(row.episodes),
                f"{100 * row.success:.1f} %",
                f"{100 * row.low:.1f} to {100 * row.high:.1f} %",
                "" if row.ride is None else "{:.1f} ({:.1f} to {:.1f})".format(*row.ride),
                "" if row.own_fault is None else str(row.own_fault),
            )
            for row in rows
        ],
    )
    episodes = sorted({row.episodes for row in rows})
    count = f"{episodes[0]}" if len(episodes) == 1 else f"{episodes[0]} to {episodes[-1]}"
    return Figure(
        name,
        title,
        f"Share of episodes with success, as each road defines it; {count} episodes per bar. Lines: 95 % Wilson "
        "intervals. Two drivers of whom one's interval holds the other's share are not told apart by it.",
        partial(_draw_success, rows),
        table=table,
    )


def _draw_success(rows: Sequence[Successes], path: Path) -> None:
    roads, drivers = (list(dict.fromkeys(getattr(row, name) for row in rows)) for name in ("road", "driver"))
    wide = 0.8 / len(drivers)
    with picture(
        path, figsize=(min(1.6 + 0.28 * len(roads) * (len(drivers) + 1), 12.0), 3.2), layout="constrained"
    ) as (figure, axes):
        axis = axes[0][0]
        for k, driver in enumerate(drivers):
            mine = [row for row in rows if row.driver == driver]
            at = [roads.index(row.road) + (k - (len(drivers) - 1) / 2) * wide for row in mine]
            share = np.array([100 * row.success for row in mine])
            low, high = np.array([100 * row.low for row in mine]), np.array([100 * row.high for row in mine])
            axis.bar(at, share, 0.86 * wide, color=colour_of(driver, drivers), alpha=_alpha(driver), label=driver)
            error = np.clip([share - low, high - share], 0.0, None)
            axis.errorbar(at, share, error, fmt="none", ecolor="black", elinewidth=1.0, capsize=min(2.5, 12 * wide))
        axis.set_xticks(range(len(roads)), roads)
        axis.set(ylabel="success [%]", ylim=(0, 104))
        axis.grid(visible=False, axis="x")
        figure.legend(loc="outside upper left", ncols=min(len(drivers), 6))


def _alpha(driver: str) -> float:
    return 0.45 if "bare" in driver else 0.9


def reward_figure(cells: Sequence[dict[str, Any]], number: int) -> Figure:
    """Learning curves of a study."""
    seeds = len({cell["seed"] for cell in cells})
    return Figure(
        "reward" if number == 1 else f"reward-{number}",
        "Reward while learning",
        f"Return of the greedy policy over 64 fixed scenes that no training draws, against the decisions trained on. "
        f"Lines: mean over {seeds} seeds; bands: its 95 % interval (Student's t), wide where there are few seeds. "
        "Dashed: behind the mask.",
        partial(plot, cells),
    )


def latency_figure(recordings: Sequence[Recording], benches: Sequence[tuple[str, dict[str, Any]]]) -> Figure | None:
    """Who took longer than so much, per recording and per load of a benchmark. None where nothing was timed."""
    panels = [(name_of(recording), _timed(recording)) for recording in recordings]
    for name, bench in benches:
        loads = dict.fromkeys(row["load"] for row in bench["rows"])
        panels += [(f"{name}, load {load}", _benched(bench, load)) for load in loads]
    panels = [(name, timed) for name, timed in panels if timed]
    if not panels:
        return None
    table = Table(
        ("run", "what", "n", "p50 [ms]", "p99 [ms]", "longest [ms]", "over the deadline"),
        [
            (
                name,
                what,
                f"{int(n.sum())}",
                *(f"{_quantile(us, n, q) / 1000:.2f}" for q in (0.5, 0.99, 1.0)),
                f"{int(n[us > DEADLINE_US].sum())}",
            )
            for name, timed in panels
            for what, (us, n) in timed.items()
        ],
    )
    return Figure(
        "latency",
        "Latency",
        "Share of ticks that took longer than so much; the dotted line is the deadline of 20 ms. Round trip: from the "
        "publication of an observation to the arrival of its action, seen by the simulator; age: until the world is "
        "stepped with it. A recording has the newest tick's of every heartbeat, five a second. Until it is decided: "
        "from the observation's stamp to the action's, of every tick.",
        partial(_draw_latency, panels),
        table=table,
    )


Timed = dict[str, tuple[Any, Any]]
"""By what was timed: values [us], ascending, and how many ticks each stands for."""


def _timed(recording: Recording) -> Timed:
    sent: dict[tuple[int, int], int] = {}
    found: dict[str, list[float]] = {ROUND_TRIP: [], AGE: [], ANSWERED: []}
    answers: list[Action] = []
    for _, _, message in recording.messages(("observation", "action", "status")):
        match message:
            case Observation():
                sent[message.epoch, message.tick] = message.stamp_ns
            case Action():
                answers.append(message)
            case Status(node="sim") if "rtt_us" in message.metrics and "age_us" in message.metrics:
                found[ROUND_TRIP].append(message.metrics["rtt_us"])
                found[AGE].append(message.metrics["age_us"])
    for answer in answers:
        stamp_ns = sent.get((answer.epoch, answer.answers_tick))
        if stamp_ns is not None:
            found[ANSWERED].append((answer.stamp_ns - stamp_ns) / 1000.0)
    return {what: (np.sort(us), np.ones(len(us))) for what, us in found.items() if us}


def _benched(bench: dict[str, Any], load: str) -> Timed:
    return {
        f"{row['what']}": centres(bench["histograms"][key_of(row)])
        for row in bench["rows"]
        if (row["load"], row["pace"]) == (load, "15hz")
    }


def _quantile(us: Any, n: Any, q: float) -> float:
    return float(us[min(int((n.cumsum() < q * n.sum()).sum()), len(us) - 1)])


def _draw_latency(panels: Sequence[tuple[str, Timed]], path: Path) -> None:
    wide = min(len(panels), 3)
    tall = -(-len(panels) // wide)
    size = (min(3.4 * wide + 0.6, 9.6), 2.7 * tall + 0.4)
    with picture(path, tall, wide, figsize=size, sharex=True, sharey=True, layout="constrained") as (figure, axes):
        shown: dict[str, Any] = {}
        for axis, (name, timed) in zip(axes.flat, panels, strict=False):
            for what, (us, n) in timed.items():
                longer = 1.0 - (n.cumsum() - n) / n.sum()
                colour, line = STYLES.get(what, (None, "-"))
                (shown[what],) = axis.step(us / 1000.0, longer, line, color=colour, linewidth=1.5)
            shown["deadline"] = axis.axvline(DEADLINE_US / 1000.0, color="black", linestyle=":", linewidth=1.2)
            axis.set(xscale="log", yscale="log", title=name)
        for axis in axes.flat[len(panels) :]:
            axis.set_visible(False)
        for axis in axes[-1]:
            axis.set_xlabel("time [ms]")
        for row in axes:
            row[0].set_ylabel("share of ticks that took longer")
        figure.legend(shown.values(), shown.keys(), loc="outside upper left", ncols=min(len(shown), 5))
