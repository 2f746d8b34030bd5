"""`fastslow evaluate`: lock-step episodes on seeds that training never saw, with Wilson intervals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from deploy.lockstep import overtake_at, run_episode
from fast_node.policy import SHIPPED, load_policy

FIRST_SEED = 1000
"""Evaluation seeds start here; training draws its scenes from other generators altogether."""


def wilson95(successes: int, n: int) -> tuple[float, float]:
    """95 % Wilson score interval of a proportion."""
    z, p = 1.96, successes / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * float(np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)))
    return max(0.0, centre - half), min(1.0, centre + half)


def evaluate(checkpoint: Path | None, episodes: int, duration_s: float) -> dict[str, Any]:
    """One row for the fast system on two-way: told at 3 s to overtake; success = passed, back in lane, no collision."""
    policy = load_policy(checkpoint or SHIPPED)
    runs = [run_episode(FIRST_SEED + i, policy, overtake_at(3.0), duration_s=duration_s) for i in range(episodes)]
    good = sum(r.passed and not r.collided for r in runs)
    speeds = np.concatenate([r.speeds for r in runs])
    accelerations = np.concatenate([r.accelerations for r in runs])
    done = [r.fulfilled_s for r in runs if r.fulfilled_s is not None]
    return {
        "schema": "fastslow.evaluate/1",
        "rows": [{
            "agent": "ours", "scenario": "two-way", "speed_set": "paper", "episodes": episodes,
            "first_seed": FIRST_SEED, "duration_s": duration_s,
            "success": good / episodes, "success_ci95": wilson95(good, episodes),
            "collisions": sum(r.collided for r in runs),
            "fulfilled_median_s": float(np.median(done)) if done else None,
            "avg_speed": float(speeds.mean()),
            "accel_std": float(accelerations.std()), "accel_var": float(accelerations.var()),
            "min_ttc_mean": float(np.mean([r.min_ttc_s for r in runs])),
            "override_share": sum(r.overridden for r in runs) / len(speeds),
        }],
    }
