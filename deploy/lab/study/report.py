"""What came of a study: its summary, the search's table, and the learning curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np

from deploy.lab.picture import colour_of, picture
from deploy.lab.statistics import t_interval, wilson95
from deploy.lab.study.cells import ALGORITHMS, FIGURES

EARLY = 30_000
"""By here the paper's agent has passed PPO's final return."""


def at(curve: Sequence[Sequence[float]], steps: float) -> float | None:
    """The last return measured at or before `steps`; None if the curve ends earlier."""
    return [value for step, value in curve if step <= steps][-1] if curve[-1][0] >= steps else None


def summary_of(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row per scenario, algorithm and variant, over its seeds; intervals are 95 %."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for r in results:
        groups.setdefault((r["scenario"], r["algorithm"], r["variant"]), []).append(r)
    rows = []
    for (scenario, algorithm, variant), some in groups.items():
        final, half = t_interval([r["curve"][-1][1] for r in some])
        early = [at(r["curve"], EARLY) for r in some]
        episodes = sum(r["episodes"] for r in some)
        good = round(sum(r["success"] * r["episodes"] for r in some))
        rows.append(
            {
                "scenario": scenario,
                "algorithm": algorithm,
                "variant": variant,
                "seeds": len(some),
                "return": final,
                "return_half": half,
                "return_early": None if None in early else mean(e for e in early if e is not None),
                "episodes": episodes,
                "success_ci95": wilson95(good, episodes),
                **{k: mean(r[k] for r in some) for k in FIGURES},
            }
        )
    ours = {r["scenario"]: r for r in rows if r["algorithm"] == "ours"}
    for row in rows:
        row["ours"] = beside(ours.get(row["scenario"], row), row)
    return rows


def beside(one: dict[str, Any], other: dict[str, Any]) -> str:
    """Whether the final return of the first is "above" or "below" the second's, the 95 % intervals apart; else ""."""
    halves = (one["return_half"], other["return_half"])
    difference = one["return"] - other["return"]
    if None in halves or abs(difference) <= sum(halves):
        return ""
    return "above" if difference > 0 else "below"


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The summary as Markdown."""
    lines = [
        f"| road | algorithm | final return | ours is | at {EARLY // 1000}k | success % | own fault, struck | speed "
        "| a var | min TTC |",
        "| --- " * 10 + "|",
    ]
    for r in rows:
        low, high = r["success_ci95"]
        early = "" if r["return_early"] is None else f"{r['return_early']:.2f}"
        name = "ours" if r["algorithm"] == "ours" else f"{r['algorithm']} {r['variant']}"
        half = "" if r["return_half"] is None else f" ± {r['return_half']:.2f}"
        lines.append(
            " ".join(
                (
                    f"| {r['scenario']} | {name} | {r['return']:.2f}{half} | {r['ours']} | {early}",
                    f"| {100 * r['success']:.1f} ({100 * low:.0f}-{100 * high:.0f})",
                    f"| {r['ego_fault_collisions']:.1f}, {r['struck_collisions']:.1f} | {r['avg_speed']:.2f}",
                    f"| {r['accel_var']:.2f} | {r['min_ttc_mean']:.1f} |",
                )
            )
        )
    most = max(r["seeds"] for r in rows)
    return "\n".join(
        [
            *lines,
            "",
            f"Up to {most} seeds. ± and brackets: 95 %, over seeds (Student's t) and over all episodes (Wilson). Ours",
            "is above or below where the intervals of the final returns are apart. Collisions: per seed.",
        ]
    )


def search_rows(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row per algorithm and trial, the best first: its mean final return on every road and variant, and over all."""
    groups: dict[tuple[str, str], dict[str, list[float]]] = {}
    for r in results:
        where = groups.setdefault((r["algorithm"], r["trial"]), {})
        where.setdefault(f"{r['scenario']} {r['variant']}", []).append(r["curve"][-1][1])
    rows: list[dict[str, Any]] = [
        {
            "algorithm": algorithm,
            "trial": trial,
            "runs": sum(map(len, where.values())),
            "returns": {place: mean(some) for place, some in where.items()},
            "return": mean(mean(some) for some in where.values()),
        }
        for (algorithm, trial), where in groups.items()
    ]
    return sorted(rows, key=lambda row: (ALGORITHMS.index(row["algorithm"]), -row["return"]))


def search_table(rows: Sequence[dict[str, Any]], chosen: dict[str, str]) -> str:
    """The search as Markdown; the chosen settings are bold."""
    places = list(rows[0]["returns"])
    lines = [f"| algorithm | settings | runs | {' | '.join(places)} | mean |", "| --- " * (4 + len(places)) + "|"]
    for row in rows:
        trial = f"**{row['trial']}**" if chosen[row["algorithm"]] == row["trial"] else row["trial"]
        returns = " | ".join(f"{row['returns'][place]:.2f}" for place in places)
        lines.append(f"| {row['algorithm']} | {trial} | {row['runs']} | {returns} | {row['return']:.3f} |")
    return "\n".join(lines)


def plot(results: Sequence[dict[str, Any]], path: Path) -> None:
    """Learning curves per road: means over seeds with 95 % bands; solid: ours, and baselines as published; dashed:
    baselines behind the mask."""
    roads = list(dict.fromkeys(r["scenario"] for r in results))
    with picture(path, 1, len(roads), figsize=(3.6 * len(roads) + 0.4, 3.0)) as (_, axes):
        for axis, road in zip(axes[0], roads, strict=True):
            for algorithm, variant in dict.fromkeys((r["algorithm"], r["variant"]) for r in results):
                curves = [
                    r["curve"]
                    for r in results
                    if (r["scenario"], r["algorithm"], r["variant"]) == (road, algorithm, variant)
                ]
                steps = [step for step, _ in curves[0]]
                points = zip(*([value for _, value in curve] for curve in curves), strict=True)
                middle, half = np.array([(m, h or 0.0) for m, h in map(t_interval, points)]).T
                colour = colour_of(algorithm, [algorithm])
                dashed = algorithm != "ours" and variant == "masked"
                axis.plot(
                    steps,
                    middle,
                    color=colour,
                    linestyle="--" if dashed else "-",
                    label=algorithm if algorithm == "ours" else f"{algorithm} {variant}",
                )
                axis.fill_between(steps, middle - half, middle + half, color=colour, alpha=0.12, linewidth=0)
            axis.set(title=road, xlabel="decisions", ylabel="evaluation return")
        axes[0][-1].legend(fontsize="small")
