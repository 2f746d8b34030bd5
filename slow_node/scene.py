"""Scene encoding (paper's Eq. 4): E_t = Enc(s_t), the nearest vehicles and the road in one short sentence."""

from __future__ import annotations

import math
from dataclasses import dataclass

from schemas.codec import rows_of
from schemas.measures import INF, gap_m, ttc_s
from schemas.messages import Lane, Observation

SIGHT_M = 150.0
BESIDE_M = 12.0
"""A lane is free when no centre of a vehicle lies within this distance of the ego's, along the road."""


@dataclass(frozen=True)
class Other:
    """A vehicle near the ego: bumper-to-bumper gap (negative: beside or behind) and speed along the road."""

    id: int
    gap_m: float
    speed_mps: float


@dataclass(frozen=True)
class Scene:
    """What the slow node knows of the road at one tick."""

    epoch: int
    tick: int
    stamp_ns: int
    scenario: str
    lanes: tuple[Lane, ...]
    x_m: float
    length_m: float
    speed_mps: float
    ego_lane: int
    home_lane: int
    """The ego's lane, or the nearest one of its own direction while it borrows an oncoming lane."""
    limit_mps: float
    lead: Other | None
    """The next vehicle ahead in `home_lane`: the one to follow, or the one being passed."""
    ttc_s: float
    """Time to collision with the next vehicle ahead in the ego's lane, oncoming or not; inf while the gap opens."""
    oncoming_gap_m: float
    """To the next vehicle that approaches; inf when none is in sight."""
    free_lanes: tuple[int, ...]
    positions: dict[int, float]
    """Centre along the road of every vehicle seen, by id."""

    @property
    def two_way(self) -> bool:
        return any(lane.direction == -1 for lane in self.lanes)

    @property
    def borrowing(self) -> bool:
        """The ego is in an oncoming lane."""
        return self.lanes[self.ego_lane].direction == -1

    def exists(self, lane: int) -> bool:
        """The lane is part of the road here."""
        return 0 <= lane < len(self.lanes) and self.lanes[lane].start_m <= self.x_m <= self.lanes[lane].end_m


def encode_scene(observation: Observation) -> Scene:
    """Enc: the observation's rows as the few quantities that a command can be about."""
    rows = [tuple(map(float, row)) for row in rows_of(observation)]
    _, x, _, vx, vy, _, length, _, lane = rows[0]
    lanes = observation.lanes
    ego_lane = min(max(int(lane), 0), len(lanes) - 1)
    own = [i for i, at in enumerate(lanes) if at.direction == 1]
    home = ego_lane if lanes[ego_lane].direction == 1 or not own else min(own, key=lambda i: abs(i - ego_lane))
    lead: Other | None = None
    ahead_m, ttc, oncoming = INF, INF, INF
    beside: set[int] = set()
    for identity, other_x, _, other_vx, _, _, other_length, _, other_lane in rows[1:]:
        index = min(max(int(other_lane), 0), len(lanes) - 1)
        gap = gap_m(x, other_x, length, other_length)
        if abs(other_x - x) < BESIDE_M:
            beside.add(index)
        if not 0.0 < other_x - x < SIGHT_M:
            continue
        if index == ego_lane and gap < ahead_m:
            ahead_m, ttc = gap, ttc_s(gap, vx - other_vx)
        if lanes[index].direction == -1 and other_vx < 0.0:
            oncoming = min(oncoming, gap)
        elif index == home and (lead is None or gap < lead.gap_m):
            lead = Other(int(identity), gap, other_vx)
    return Scene(
        epoch=observation.epoch,
        tick=observation.tick,
        stamp_ns=observation.stamp_ns,
        scenario=observation.scenario,
        lanes=lanes,
        x_m=x,
        length_m=length,
        speed_mps=math.hypot(vx, vy),
        ego_lane=ego_lane,
        home_lane=home,
        limit_mps=lanes[ego_lane].speed_limit_mps,
        lead=lead,
        ttc_s=ttc,
        oncoming_gap_m=oncoming,
        free_lanes=tuple(
            i for i, at in enumerate(lanes) if at.start_m <= x <= at.end_m and (i == ego_lane or i not in beside)
        ),
        positions={int(row[0]): row[1] for row in rows[1:]},
    )


def describe(scene: Scene) -> str:
    """E_t as text: some forty tokens, each of which costs the embedded model ten milliseconds."""
    lead = scene.lead
    parts = [
        f"{'two-way' if scene.two_way else 'one-way'} road, lanes 0-{len(scene.lanes) - 1}, we are in {scene.ego_lane}",
        f"{scene.speed_mps:.0f} of {scene.limit_mps:.0f} m/s",
        f"car ahead {lead.gap_m:.0f} m at {lead.speed_mps:.1f} m/s" if lead else "no car ahead",
    ]
    if math.isfinite(scene.oncoming_gap_m):
        parts.append(f"oncoming car {scene.oncoming_gap_m:.0f} m")
    busy = [str(i) for i in range(len(scene.lanes)) if i not in scene.free_lanes]
    if busy:
        parts.append(f"lane {', '.join(busy)} blocked")
    return "; ".join(parts)
