"""The numbers of an episode, and of many: what a table's row says.

A share or rate named `x` has a sibling `x_of`: how many episodes, ticks, decisions or minutes it is of. Nothing to
count is nan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from schemas.driving.measures import TTC_CAP_S

LANE_OPEN_S = 1.0
"""A wished lane was feasible where the way to it was open for so long in all."""


@dataclass(frozen=True, kw_only=True)
class EpisodeResult:
    """One episode's numbers; `sim_node.metrics` has their definitions."""

    success: bool
    collided: bool
    struck: bool
    passed: bool
    ticks: int
    seconds: float
    avg_speed: float
    max_speed: float
    min_speed: float
    accel_sum: float
    accel_square_sum: float
    jerk_rms: float
    min_ttc_s: float
    headway_s: float
    progress_m: float
    lane_changes: int
    in_lane: float
    """Share of the ticks with a wish in the wished lane."""
    speed_ticks: int
    """In which the wished speed was feasible; see the module."""
    speed_complied: int
    """Of those, within 0.5 m/s of it."""
    time_to_comply_s: float
    lane_open_s: float
    """In which the ego held its lane and could have begun to change towards the wished one."""
    override_share: float
    lane_flips: int
    changes_given_up: int
    accel_sign_changes: int
    led_ticks: int
    """With a leader of the ego's direction in its lane, within 100 m."""
    close_ticks: int
    """Of those, with less than a second to it."""
    asked_ticks: int
    """In which there was a wish."""
    asked_speed: float
    """Mean over those [m/s]; nan without any."""
    fulfilled_s: float
    """Seconds from the wish to its fulfilment; nan: never."""
    decisions: int
    decisions_with_choice: int
    decisions_closed_by_mask: int
    decisions_closed_by_wish: int
    ride_score: float
    """0 to 100; see `sim_node.ride`."""
    actuator_ticks: int = 0
    """In which the actuator did not carry out what was decided."""

    @property
    def lane_complied(self) -> bool:
        """It reached the wished lane."""
        return math.isfinite(self.time_to_comply_s)

    @property
    def lane_feasible(self) -> bool:
        """It could have reached the wished lane, or did."""
        return self.lane_complied or self.lane_open_s >= LANE_OPEN_S


def summarise(episodes: Sequence[EpisodeResult]) -> dict[str, float]:
    """The table's numbers over several episodes; speeds and accelerations weighted by ticks.

    `ride_score` is the mean over episodes; `ride_score_low` and `ride_score_high` are its 95 % interval by the normal
    distribution, mean +- 1.96 standard errors, within 0 to 100.
    """
    n = len(episodes)
    ticks, total = [e.ticks for e in episodes], sum(e.ticks for e in episodes)
    asked = [e.asked_ticks for e in episodes]

    def mean(name: str) -> float:
        values = np.array([getattr(e, name) for e in episodes], np.float64)
        return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")

    def weighted(name: str, weights: Sequence[int]) -> float:
        whole = sum(weights)
        return sum(getattr(e, name) * w for e, w in zip(episodes, weights, strict=True) if w) / whole if whole else nan

    def count(name: str) -> int:
        return int(sum(getattr(e, name) for e in episodes))

    nan = float("nan")
    a_mean = sum(e.accel_sum for e in episodes) / total
    accel_var = max(sum(e.accel_square_sum for e in episodes) / total - a_mean**2, 0.0)
    ttc = np.array([e.min_ttc_s for e in episodes])
    under_cap = ttc[ttc < TTC_CAP_S]
    ride, ride_low, ride_high = ride_interval([e.ride_score for e in episodes])
    minutes = sum(e.seconds for e in episodes) / 60.0
    wished = sum(e.asked_ticks > 0 for e in episodes)
    decisions = count("decisions")
    return {
        "episodes": n,
        **_share("success", count("success"), n),
        "ego_fault_collisions": sum(e.collided and not e.struck for e in episodes),
        "struck_collisions": count("struck"),
        "ride_score": ride,
        "ride_score_low": nan if ride_low is None else ride_low,
        "ride_score_high": nan if ride_high is None else ride_high,
        "avg_speed": weighted("avg_speed", ticks),
        "max_speed": mean("max_speed"),
        "min_speed": mean("min_speed"),
        "accel_std": math.sqrt(accel_var),
        "accel_var": accel_var,
        "jerk_rms": weighted("jerk_rms", ticks),
        **_rate("lane_flips_per_min", count("lane_flips"), minutes),
        **_rate("changes_given_up_per_min", count("changes_given_up"), minutes),
        **_rate("accel_sign_changes_per_min", count("accel_sign_changes"), minutes),
        "min_ttc_mean": float(ttc.mean()),
        "min_ttc_mean_under_cap": float(under_cap.mean()) if len(under_cap) else nan,
        "min_ttc_median": float(np.median(ttc)),
        "min_ttc_p5": float(np.percentile(ttc, 5)),
        **_share("min_ttc_capped_share", n - len(under_cap), n),
        "headway_s": mean("headway_s"),
        **_share("headway_under_1s_share", count("close_ticks"), count("led_ticks")),
        "progress_m": mean("progress_m"),
        "lane_changes": mean("lane_changes"),
        **_share("lane_compliance", count("lane_complied"), n),
        **_share("lane_feasible", count("lane_feasible"), n),
        **_share("lane_compliance_feasible", count("lane_complied"), count("lane_feasible")),
        **_share("speed_compliance", count("speed_complied"), count("speed_ticks")),
        "speed_ticks": count("speed_ticks"),
        "time_to_comply_s": mean("time_to_comply_s"),
        "in_wished_lane": weighted("in_lane", asked),
        "in_wished_lane_of": sum(asked),
        **_share(
            "never_complied_share", sum(e.asked_ticks > 0 and math.isnan(e.fulfilled_s) for e in episodes), wished
        ),
        "time_to_fulfil_s": mean("fulfilled_s"),
        "avg_speed_asked": weighted("asked_speed", asked),
        "avg_speed_asked_of": sum(asked),
        "override_share": weighted("override_share", ticks),
        "override_share_of": total,
        **_share("actuator_share", count("actuator_ticks"), total),
        "actuator_episodes": sum(e.actuator_ticks > 0 for e in episodes),
        "decisions": decisions,
        **_share("decisions_with_choice_share", count("decisions_with_choice"), decisions),
        **_share("decisions_closed_by_mask_share", count("decisions_closed_by_mask"), decisions),
        **_share("decisions_closed_by_wish_share", count("decisions_closed_by_wish"), decisions),
    }


def ride_interval(scores: Sequence[float]) -> tuple[float, float | None, float | None]:
    """Mean of ride scores and its 95 % interval by the normal distribution; a single score has none."""
    mean, n = float(np.mean(scores)), len(scores)
    if n < 2:
        return mean, None, None
    half = 1.96 * float(np.std(scores, ddof=1)) / math.sqrt(n)
    return mean, max(mean - half, 0.0), min(mean + half, 100.0)


def _share(name: str, part: int, whole: int) -> dict[str, float]:
    return {name: part / whole if whole else float("nan"), f"{name}_of": whole}


def _rate(name: str, times: int, minutes: float) -> dict[str, float]:
    return {name: times / minutes, f"{name}_of": minutes}
