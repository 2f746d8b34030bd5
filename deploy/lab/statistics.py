"""The intervals of every table here: of a proportion, and of a mean over a few seeds."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import mean, stdev

from slow_node.evaluation.score import wilson95

__all__ = ["t_interval", "wilson95"]

T975 = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262)
"""Student's t, two-sided 95 %, for 1 to 9 degrees of freedom."""


def t_interval(values: Sequence[float]) -> tuple[float, float | None]:
    """Mean and half width of its 95 % interval (Student's t); a single value has none."""
    n = len(values)
    if n < 2:
        return values[0], None
    return mean(values), (T975[n - 2] if n - 2 < len(T975) else 1.96) * stdev(values) / n**0.5
