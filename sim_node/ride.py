"""The ride score, 0 to 100: one number by which drivers are compared, episode by episode.

Built as CARLA's driving score and LaMPilot's are: parts with weights, and a product with what safety takes away.

    score = 100 * safety * success * (0.35 comfort + 0.35 progress + 0.30 obedience)

* safety is 0 after a collision that is the ego's fault: nothing makes up for it. Otherwise it is the product of
  `CLOSE_TTC` .. 1, rising with the smallest time to collision from 0 to `SAFE_TTC_S`, and of 1 less half of the share
  of ticks in which the ego follows with less than a second. A collision that is another's fault is a time to collision
  of 0: it happened to the passenger, too.
* success: 1 as the scenario defines it, `FAILED` otherwise: who comes comfortably to the wrong place has not driven
  well.
* comfort: the mean of four parts, each `half / (half + x)`: 1 at rest, one half at the value in `COMFORT`, never quite
  0. x is the root mean square of jerk and of acceleration, the changes of sign of the acceleration in a minute, and the
  lane changes given up in a minute. No part is ever full, so the score does not saturate.
* progress: the distance driven, no faster than wished, over the distance at the wished speed; half of that counts
  as none. Whoever wishes to stand still has it whole.
* obedience: the mean of those of three that there are: how soon the wish was fulfilled (`half / (half + seconds)`, 0
  where it never was), the share of the feasible ticks at the wished speed, and the share of the ticks behind a leader
  at 90 % of the wished headway or more. Without a wish it is 1: nothing was asked.

The weights are a judgement, not a measurement: comfort and progress pull against each other and weigh the same; to be
obeyed is what the passenger speaks for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

COMFORT_WEIGHT, PROGRESS, OBEDIENCE = 0.35, 0.35, 0.30
FAILED = 0.4
"""What is left of the score of an episode without success."""
SAFE_TTC_S = 8.0
CLOSE_TTC = 0.5
"""What is left of the score where a collision was 0 s away."""
CLOSE_FOLLOWING = 0.5
"""What following within a second all the time takes away."""
COMFORT = {"jerk_rms": 1.5, "accel_rms": 1.0, "accel_sign_changes_per_min": 6.0, "changes_given_up_per_min": 1.0}
"""Where a part of comfort is one half: [m/s3], [m/s2], [1/min], [1/min]."""
FULFILLED_S = 20.0
"""A wish that is fulfilled after so long counts one half."""


@dataclass(frozen=True, kw_only=True)
class Ride:
    """What the score looks at in one episode; see the module."""

    own_fault: bool
    success: bool
    min_ttc_s: float
    """0 after any collision."""
    close_share: float
    """Of all ticks: behind a leader with less than a second."""
    jerk_rms: float
    accel_rms: float
    accel_sign_changes_per_min: float
    changes_given_up_per_min: float
    progress: float
    """Distance over the distance at the wished speed, 0 to 1; nan: to stand still was wished."""
    asked: bool
    """Whether anything was wished at all."""
    fulfilled_s: float
    """Seconds from the wish to its fulfilment; nan: never."""
    speed_kept: float
    """Share of the feasible ticks at the wished speed; nan: never feasible."""
    headway_kept: float
    """Share of the ticks behind a leader at the wished headway; nan: no leader, or no headway was wished."""


def safety(ride: Ride) -> float:
    """The factor for safety, 0 to 1."""
    if ride.own_fault:
        return 0.0
    margin = min(max(ride.min_ttc_s / SAFE_TTC_S, 0.0), 1.0)
    return (CLOSE_TTC + (1.0 - CLOSE_TTC) * margin) * (1.0 - CLOSE_FOLLOWING * ride.close_share)


def comfort(ride: Ride) -> float:
    """The part for comfort, 0 to 1."""
    values: list[float] = [getattr(ride, name) for name in COMFORT]
    return sum(half / (half + x) for x, half in zip(values, COMFORT.values(), strict=True)) / len(values)


def progress(ride: Ride) -> float:
    """The part for progress, 0 to 1."""
    return 1.0 if math.isnan(ride.progress) else min(max(2.0 * ride.progress - 1.0, 0.0), 1.0)


def obedience(ride: Ride) -> float:
    """The part for obedience, 0 to 1."""
    if not ride.asked:
        return 1.0
    soon = 0.0 if math.isnan(ride.fulfilled_s) else FULFILLED_S / (FULFILLED_S + ride.fulfilled_s)
    parts = [soon, *(kept for kept in (ride.speed_kept, ride.headway_kept) if not math.isnan(kept))]
    return sum(parts) / len(parts)


def ride_score(ride: Ride) -> float:
    """The score of one episode, 0 to 100."""
    parts = COMFORT_WEIGHT * comfort(ride) + PROGRESS * progress(ride) + OBEDIENCE * obedience(ride)
    return 100.0 * safety(ride) * (1.0 if ride.success else FAILED) * parts
