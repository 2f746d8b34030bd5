"""Two-way road: slow leads in the ego's lane, oncoming traffic in the lane that must be borrowed to pass them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from schemas.messages import Lane


class Spawn(NamedTuple):
    """Vehicles at time 0, the ego first; SI units, road frame."""

    x: NDArray[np.float64]
    lane: NDArray[np.int64]
    """Index in the scenario's lanes."""
    direction: NDArray[np.int64]
    """+1 with the ego, -1 oncoming."""
    speed: NDArray[np.float64]
    """Along the vehicle's own direction, so never negative."""
    target_speed: NDArray[np.float64]
    delta: NDArray[np.float64]
    """IDM's speed exponent."""


@dataclass(frozen=True, kw_only=True)
class TwoWay:
    """The scenario's data. Ranges are (low, high) of a uniform draw; SI units."""

    name: str = "two-way"
    road_length_m: float = 3000.0
    end_margin_m: float = 200.0
    """An episode ends this far before the road does: upstream cars turn round at its end."""
    lane_y_m: tuple[float, ...] = (0.0, 4.0)
    lane_direction: tuple[int, ...] = (-1, 1)
    lane_width_m: float = 4.0
    speed_limit_mps: float = 20.0
    speed_floor_mps: float = 0.0
    speed_ceiling_mps: float = 8.0
    duration_s: float = 40.0
    ego_lane: int = 1
    ego_x_m: float = 400.0
    """Far enough in that an oncoming car stays on the road for more than `duration_s`."""
    ego_speed_mps: tuple[float, float] = (4.0, 6.0)
    leads_n: tuple[int, int] = (1, 3)
    """Both ends included."""
    lead_speed_mps: tuple[float, float] = (3.0, 4.5)
    lead_first_m: tuple[float, float] = (18.0, 30.0)
    """Ahead of the ego, centre to centre."""
    lead_gap_m: tuple[float, float] = (25.0, 45.0)
    follower_behind_m: tuple[float, float] = (20.0, 40.0)
    follower_speed_mps: tuple[float, float] = (5.0, 7.0)
    oncoming_n: tuple[int, int] = (1, 3)
    oncoming_speed_mps: tuple[float, float] = (5.0, 7.0)
    oncoming_first_m: tuple[float, float] = (60.0, 140.0)
    oncoming_gap_m: tuple[float, float] = (60.0, 160.0)
    delta: tuple[float, float] = (3.5, 4.5)

    @property
    def vehicles_max(self) -> int:
        """The most vehicles that `spawn` makes: ego, leads, follower, oncoming."""
        return 2 + self.leads_n[1] + self.oncoming_n[1]

    @property
    def goal_x_m(self) -> float:
        """Where an episode ends."""
        return self.road_length_m - self.end_margin_m

    def lanes(self) -> tuple[Lane, ...]:
        """The lanes as they are published."""
        return tuple(
            Lane(
                y_m=y,
                start_m=0.0,
                end_m=self.road_length_m,
                direction=1 if direction > 0 else -1,
                width_m=self.lane_width_m,
                speed_limit_mps=self.speed_limit_mps,
                kind="main" if direction > 0 else "oncoming",
            )
            for y, direction in zip(self.lane_y_m, self.lane_direction, strict=True)
        )

    def spawn(self, rng: Generator) -> Spawn:
        """Draw the vehicles of one episode: the ego, the leads from near to far, the follower, the oncoming cars.

        Pure: the same generator state gives the same vehicles. The follower starts no faster than the ego, so that no
        scene opens with a forced braking.
        """
        leads_n = int(rng.integers(self.leads_n[0], self.leads_n[1] + 1))
        oncoming_n = int(rng.integers(self.oncoming_n[0], self.oncoming_n[1] + 1))
        own, other = self.ego_lane, self.lane_direction.index(-1)
        n = 2 + leads_n + oncoming_n
        lane = np.full(n, own, np.int64)
        lane[2 + leads_n :] = other
        direction = np.array(self.lane_direction, np.int64)[lane]
        x, speed = np.empty(n), np.empty(n)
        x[0], speed[0] = self.ego_x_m, rng.uniform(*self.ego_speed_mps)
        target = speed.copy()
        at = x[0]
        for i in range(1, 1 + leads_n):
            at += rng.uniform(*(self.lead_first_m if i == 1 else self.lead_gap_m))
            x[i] = at
            speed[i] = target[i] = rng.uniform(*self.lead_speed_mps)
        follower = 1 + leads_n
        x[follower] = x[0] - rng.uniform(*self.follower_behind_m)
        target[follower] = rng.uniform(*self.follower_speed_mps)
        speed[follower] = min(target[follower], speed[0])
        at = x[0]
        for i in range(follower + 1, n):
            at += rng.uniform(*(self.oncoming_first_m if i == follower + 1 else self.oncoming_gap_m))
            x[i] = at
            speed[i] = target[i] = rng.uniform(*self.oncoming_speed_mps)
        return Spawn(x, lane, direction, speed, target, rng.uniform(*self.delta, size=n))


TWO_WAY = TwoWay()


def spawn(rng: Generator) -> Spawn:
    """Draw one episode of `TWO_WAY`."""
    return TWO_WAY.spawn(rng)
