"""Percentiles, histograms and tables of the benchmark, and what two of its files say about each other."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct

from deploy.lab.picture import picture
from schemas.runtime.process import ConfigError

SCHEMA = "fastslow.bench/1"
TICKS_FOR_P999 = 3000
"""From fewer, p99.9 is hardly more than the maximum, and is not printed."""
DEADLINE_US = 20_000.0
_STEP = math.log(1.01)


class Row(Struct, frozen=True, kw_only=True):
    """One line of the table. Times in microseconds; `p999_us` is None where there are too few ticks."""

    what: str
    load: str
    pace: str
    n: int
    p50_us: float
    p90_us: float
    p99_us: float
    p999_us: float | None
    max_us: float
    misses: int


def row_of(what: str, load: str, pace: str, took_us: Sequence[float], skipped: int = 0) -> Row:
    """The row of some round trips. `skipped`: due times at which nothing was sent in time; they are misses too."""
    took = np.asarray(took_us, float)
    if not len(took):
        raise ValueError(f"{what}, {load}, {pace}: not one round trip")
    p50, p90, p99, p999 = (round(float(p), 1) for p in np.percentile(took, (50, 90, 99, 99.9)))
    return Row(
        what=what,
        load=load,
        pace=pace,
        n=len(took),
        p50_us=p50,
        p90_us=p90,
        p99_us=p99,
        p999_us=p999 if len(took) >= TICKS_FOR_P999 else None,
        max_us=round(float(took.max()), 1),
        misses=int((took > DEADLINE_US).sum()) + skipped,
    )


def histogram(took_us: Iterable[float]) -> dict[str, int]:
    """Counts by bucket; bucket b holds what lies within 1.01**b to 1.01**(b + 1) microseconds."""
    counts = Counter(math.floor(math.log(max(t, 1.0)) / _STEP) for t in took_us)
    return {str(b): counts[b] for b in sorted(counts)}


def centres(counts: dict[str, int]) -> tuple[Any, Any]:
    """The buckets' middle values [us] and their counts."""
    buckets = np.array([int(b) for b in counts], float)
    return np.exp((buckets + 0.5) * _STEP), np.array(list(counts.values()))


def key_of(row: dict[str, Any]) -> str:
    """The name of a row's histogram."""
    return f"{row['what']}/{row['load']}/{row['pace']}"


def read(path: Path) -> dict[str, Any]:
    """A saved benchmark. Raises `ConfigError` if it is none, or one without histograms."""
    try:
        result: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        known = result.get("schema") == SCHEMA
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except (ValueError, AttributeError):
        known = False
    if not known:
        raise ConfigError(f"{path} is no result of `fastslow bench latency` (schema {SCHEMA})")
    if not {key_of(row) for row in result["rows"]} <= result.get("histograms", {}).keys():
        raise ConfigError(
            f"{path} has no histograms, as what --json prints: compare the latency.json that the run "
            "saved in its folder"
        )
    return result


HOST = ("realtime", "cpu", "kernel", "cores", "payload_bytes")
"""What two runs must have in common for their figures to be about the software."""


def compare(a: dict[str, Any], b: dict[str, Any], draws: int = 500) -> dict[str, Any]:
    """For every row that both have: p50 and p99 of each, the ratio b / a, its 95 % interval by bootstrap, and the
    p99.9, maximum and misses of each. Beside these `rows`: the names of the rows that only one of them has (`only_a`,
    `only_b`), and what of `HOST` differs (`hosts`: a's and b's).

    The interval knows of chance alone: two runs on a machine whose speed drifts differ by more than it says.
    """
    rng = np.random.default_rng(0)
    ours, theirs = ({key_of(row): row for row in result["rows"]} for result in (a, b))
    hosts = [[result.get("host", {}).get(name) for result in (a, b)] for name in HOST]
    rows: list[dict[str, Any]] = []
    for key in [key for key in theirs if key in ours]:
        one, other = ours[key], theirs[key]
        found: dict[str, Any] = {name: other[name] for name in ("what", "load", "pace")}
        resampled = [_resampled(result["histograms"][key], draws, rng) for result in (a, b)]
        for i, name in enumerate(("p50_us", "p99_us")):
            low, high = np.percentile(resampled[1][i] / resampled[0][i], (2.5, 97.5))
            found[name] = {
                "a": one[name],
                "b": other[name],
                "ratio": round(other[name] / one[name], 3),
                "low": round(float(low), 3),
                "high": round(float(high), 3),
                "differ": not low <= 1.0 <= high,
            }
        rows.append({**found, **{name: {"a": one[name], "b": other[name]} for name in ("p999_us", "max_us", "misses")}})
    return {
        "rows": rows,
        "only_a": [key for key in ours if key not in theirs],
        "only_b": [key for key in theirs if key not in ours],
        "hosts": {name: pair for name, pair in zip(HOST, hosts, strict=True) if pair[0] != pair[1]},
    }


def compared(result: dict[str, Any]) -> Iterator[str]:
    """A comparison for people."""
    for name, (one, other) in result["hosts"].items():
        yield f"not the same {name}: {one} and {other}"
    for row in result["rows"]:
        said = [
            f"{name[:3]} {f['a']:.0f} -> {f['b']:.0f} us, x{f['ratio']:.2f} [{f['low']:.2f}, {f['high']:.2f}]"
            f"{' *' if f['differ'] else '  '}"
            for name, f in row.items()
            if name in ("p50_us", "p99_us")
        ]
        for name, label in (("p999_us", "p99.9"), ("max_us", "max"), ("misses", "misses")):
            one, other = ("-" if row[name][of] is None else f"{row[name][of]:.0f}" for of in ("a", "b"))
            said.append(f"{label} {one} -> {other}")
        yield f"{row['load']:<7} {row['pace']:<13} {row['what']:<12} {'   '.join(said)}"
    for of, keys in (("a", result["only_a"]), ("b", result["only_b"])):
        if keys:
            yield f"only in {of}: {', '.join(keys)}"
    if result["rows"]:
        yield "* differs by more than chance; a machine whose speed drifts does that too: compare floor with floor"


def _resampled(counts: dict[str, int], draws: int, rng: np.random.Generator) -> tuple[Any, Any]:
    values, n = centres(counts)
    total = int(n.sum())
    cumulative = rng.multinomial(total, n / total, size=draws).cumsum(axis=1)
    p50, p99 = (values[(cumulative >= q * total).argmax(axis=1)] for q in (0.5, 0.99))
    return p50, p99


def plot(result: dict[str, Any], path: Path) -> None:
    """The paced distributions as a picture: how many of the ticks took longer than so much, on logarithmic axes."""
    loads = list(dict.fromkeys(row["load"] for row in result["rows"]))
    with picture(path, 1, len(loads), figsize=(5 * len(loads), 4), sharey=True) as (_, axes):
        for axis, load in zip(axes[0], loads, strict=True):
            for row in result["rows"]:
                if row["load"] != load or row["pace"] != "15hz":
                    continue
                values, counts = centres(result["histograms"][key_of(row)])
                longer = 1.0 - (counts.cumsum() - counts) / counts.sum()
                axis.step(values / 1000.0, longer, label=row["what"], linewidth=2.0 if row["what"] == "ours" else 1.0)
            axis.axvline(DEADLINE_US / 1000.0, color="grey", linestyle=":")
            axis.set(xscale="log", yscale="log", title=f"load: {load}", xlabel="round trip [ms]")
        axes[0][0].set_ylabel("share of ticks that took longer")
        axes[0][0].legend()


def table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The rows for people."""
    lines = [
        f"{'load':<7} {'pace':<13} {'what':<12} {'n':>7} {'p50':>8} {'p90':>8} {'p99':>8} {'p99.9':>8} {'max':>8} "
        f"{'misses':>6}   (us)"
    ]
    for row in rows:
        p999 = "-" if row["p999_us"] is None else f"{row['p999_us']:.0f}"
        lines.append(
            f"{row['load']:<7} {row['pace']:<13} {row['what']:<12} {row['n']:>7} {row['p50_us']:>8.0f} "
            f"{row['p90_us']:>8.0f} {row['p99_us']:>8.0f} {p999:>8} {row['max_us']:>8.0f} {row['misses']:>6}"
        )
    return lines
