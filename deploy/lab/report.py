"""What `fastslow evaluate` shows of its rows: a table, and a picture of speed against comfort."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deploy.lab.picture import picture

PAPER: dict[str, tuple[float, float, float]] = {
    "highway": (25.46, 0.38, 8.65),
    "merge": (14.51, 0.32, 18.9),
    "two-way": (6.80, 0.19, 4.54),
}
"""What the paper reports of its own driver: average speed [m/s], acceleration variance [(m/s2)2], min TTC, mean [s]."""


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}%"


def table(result: dict[str, Any]) -> str:
    """The rows as plain text, one line each."""
    width = max(14, 2 + max(len(r["agent"]) for r in result["rows"]))
    lines = [
        f"{'scenario':<16}{'agent':<{width}}{'wish':>6}{'success':>22}{'ride':>16}{'own':>5}{'hit':>5}{'speed':>7}"
        f"{'a var':>7}{'min TTC':>9}{'lane ok':>9}{'feasible':>9}{'of these':>9}{'speed ok':>9}{'masked':>8}"
    ]
    for r in result["rows"]:
        low, high = r["success_ci95"]
        good = f"{100 * r['success']:.1f} % ({100 * low:.0f}-{100 * high:.0f})"
        ride = f"{r['ride_score']:.1f}"
        if r["ride_score_low"] is not None:
            ride += f" ({r['ride_score_low']:.0f}-{r['ride_score_high']:.0f})"
        wish = "-" if r["wish_mps"] is None else f"{r['wish_mps']:g}"
        lines.append(
            f"{r['scenario']:<16}{r['agent']:<{width}}{wish:>6}{good:>22}{ride:>16}"
            f"{r['ego_fault_collisions']:>5}{r['struck_collisions']:>5}"
            f"{r['avg_speed']:>7.2f}{r['accel_var']:>7.2f}{r['min_ttc_mean']:>9.2f}{100 * r['lane_compliance']:>8.1f}%"
            f"{_percent(r['lane_feasible']):>9}{_percent(r['lane_compliance_feasible']):>9}"
            f"{_percent(r['speed_compliance']):>9}{100 * r['override_share']:>7.1f}%"
        )
    lines += [
        f"{name}: nobody survived {', '.join(map(str, seeds))}"
        for name, seeds in result["unsurvived"].items()
        if seeds and len(result["rows"]) > 1
    ]
    return "\n".join(lines)


def plot(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Speed against comfort, as a PNG: a panel per scenario, a colour per agent, a point per wish. Solid, left:
    acceleration variance; dashed and hollow, right: mean of the smallest TTC; stars: the paper's own driver."""
    names, agents = (list(dict.fromkeys(r[key] for r in rows)) for key in ("scenario", "agent"))
    with picture(path, 1, len(names), figsize=(5.5 * len(names), 4.5), layout="constrained") as (figure, axes):
        legend = {}
        for axis, name in zip(axes[0], names, strict=True):
            right = axis.twinx()
            for k, agent in enumerate(agents):
                points = sorted(
                    (r["wish_mps"], r["avg_speed"], r["accel_var"], r["min_ttc_mean"])
                    for r in rows
                    if (r["scenario"], r["agent"]) == (name, agent)
                )
                _, speed, variance, ttc = zip(*points, strict=True)
                (legend[agent],) = axis.plot(speed, variance, f"C{k}o-")
                right.plot(speed, ttc, f"C{k}o--", markerfacecolor="none")
                for wish, x, y, _ in points:
                    axis.annotate(
                        f"{wish:g}", (x, y), (0, 6), textcoords="offset points", ha="center", fontsize="small"
                    )
            if name in PAPER:
                x, y, seconds = PAPER[name]
                (legend["the paper's"],) = axis.plot(x, y, "k*", markersize=12)
                right.plot(x, seconds, "k*", markersize=12, markerfacecolor="none")
            axis.set(title=name, xlabel="average speed [m/s]", ylabel="acceleration variance [(m/s2)2], solid")
            right.set_ylabel("smallest TTC, mean [s], dashed, hollow")
            for side in (axis, right):
                side.margins(y=0.1)
                side.set_ylim(bottom=0)
        figure.legend(legend.values(), legend.keys(), loc="outside upper center", ncols=len(legend), fontsize="small")
