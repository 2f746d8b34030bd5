"""A point of a curve, and where a curve breaks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deploy.bench.latency_results import DEADLINE_US

Point = dict[str, Any]


def point_of(x: int, took_ns: Sequence[int], **more: object) -> Point:
    p50, p99 = (round(float(p) / 1000.0, 1) for p in np.percentile(took_ns, (50, 99)))
    return {"x": x, "n": len(took_ns), "p50_us": p50, "p99_us": p99, **more}


def broken(point: Point) -> str:
    """What is wrong with a point; empty if p99 holds the deadline and nothing is missed."""
    if "breaks" in point:
        return str(point["breaks"])
    if point["p99_us"] > DEADLINE_US:
        return f"p99 of {point['p99_us'] / 1000.0:.1f} ms exceeds the deadline"
    return f"{point['misses']} of {point['n']} ticks missed" if point.get("misses") else ""


def breaking_point(points: Sequence[Point]) -> dict[str, Any]:
    """The last point that holds, the first that does not, and what is wrong with that one."""
    holds: int | None = None
    for point in points:
        if why := broken(point):
            return {"holds": holds, "breaks_at": point["x"], "then": why}
        holds = point["x"]
    return {"holds": holds, "breaks_at": None, "then": "nothing broke in this range"}
