"""Two drivers on the same seeds: every episode by itself, and the difference between the two with its interval."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from deploy.lab.statistics import t_interval
from sim_node.results import EpisodeResult

Episode = dict[str, Any]
COMPARED = ("ride_score", "success", "collided", "avg_speed", "min_ttc_s", "jerk_rms", "override_share")
"""What the difference is taken of, episode by episode."""


def episode_of(place: Mapping[str, Any], seed: int, result: EpisodeResult) -> Episode:
    """One row: who drove where, the seed, and the episode's numbers."""
    return {**place, "seed": seed, **asdict(result)}


def write_rows(episodes: Sequence[Episode], path: Path) -> None:
    """A CSV file with a row per episode."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(episodes[0]))
        writer.writeheader()
        writer.writerows(episodes)


def compare(episodes: Sequence[Episode], first: str, second: str) -> list[dict[str, Any]]:
    """A row per scenario and wish: for each of `COMPARED` the mean of `second` minus `first`, and its interval.

    `ci95` is half the width of it. Pairs in which either has no such number are left out; `pairs` says how many count.
    """
    places = list(dict.fromkeys((e["scenario"], e["wish_mps"]) for e in episodes))
    rows = []
    for scenario, wish in places:
        here = [e for e in episodes if (e["scenario"], e["wish_mps"]) == (scenario, wish)]
        one, other = ({e["seed"]: e for e in here if e["agent"] == agent} for agent in (first, second))
        row: dict[str, Any] = {"scenario": scenario, "wish_mps": wish, "first": first, "second": second}
        for name in COMPARED:
            pairs = [float(other[seed][name]) - float(one[seed][name]) for seed in one if seed in other]
            differences = [d for d in pairs if math.isfinite(d)]
            mean, half = t_interval(differences) if differences else (None, None)
            row[name] = {"difference": mean, "ci95": half, "pairs": len(differences)}
        rows.append(row)
    return rows


def paired_table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as plain text; * marks a difference whose interval leaves 0 out."""
    lines = [f"{rows[0]['second']} minus {rows[0]['first']}, on the same seeds (95 %):"]
    for row in rows:
        wish = "" if row["wish_mps"] is None else f", {row['wish_mps']:g} m/s wished"
        lines.append(f"{row['scenario']}{wish}")
        for name in COMPARED:
            found = row[name]
            if found["difference"] is None:
                continue
            half = found["ci95"]
            sure = "" if half is None or abs(found["difference"]) <= half else " *"
            around = "" if half is None else f" +- {half:.3f}"
            lines.append(f"  {name:<16}{found['difference']:+.3f}{around}{sure}  ({found['pairs']} pairs)")
    return "\n".join(lines)
