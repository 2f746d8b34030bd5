"""Scene encoding (paper's Eq. 5): E_t = Enc(s_t), the road and the most relevant vehicles in one short sentence."""

from __future__ import annotations

import math
from dataclasses import dataclass

from schemas.driving.measures import INF, ttc_s
from schemas.driving.road import (
    ID,
    LANE,
    VX,
    VY,
    X,
    gap_between,
    has_passed,
    home_lane,
    is_oncoming,
    lane_ends,
    lane_table,
)
from schemas.wire.codec import rows_of
from schemas.wire.messages import Lane, Observation

Row = list[float]
"""A vehicle: `ROW_COLUMNS`."""

SIGHT_M = 150.0
BESIDE_M = 12.0
"""A lane is free when no centre of a vehicle lies within this distance of the ego's, along the road."""
RELEVANT_M, RELEVANT_N = 80.0, 4
"""The nearest vehicles around, up to this gap and number, are described beside the lead and the oncoming car."""
CLEAR_OF_SLOW_M = 100.0
"""A lane without a slow car within this is worth moving back to: farther than a car to overtake, or it would be left
again at once."""
SLOWER_THAN_LIMIT_MPS = 0.5
"""A car ahead that drives more than this below the limit is slow."""
LANE_ENDS_M = 300.0
"""A lane that ends within this distance is said to end."""


@dataclass(frozen=True)
class Other:
    """A vehicle near the ego: bumper-to-bumper gap (negative: beside or behind) and speed along the road."""

    id: int
    gap_m: float
    speed_mps: float


@dataclass(frozen=True)
class Neighbour:
    """The next vehicle ahead of or behind the ego in its lane or one beside it."""

    side: int
    """Its lane's index minus the ego's: -1 left, 0 same, 1 right."""
    ahead: bool
    gap_m: float
    """Bumper to bumper; negative: beside the ego."""
    closing_mps: float
    """How fast the gap shrinks; negative: it grows."""


@dataclass(frozen=True)
class Scene:
    """What the slow node knows of the road at one tick."""

    epoch: int
    tick: int
    stamp_ns: int
    scenario: str
    lanes: tuple[Lane, ...]
    ego: Row
    speed_mps: float
    ego_lane: int
    home_lane: int
    """The lane to go on in: not the ego's where that is an oncoming one, or ends (`schemas.driving.road.home_lane`)."""
    limit_mps: float
    lead: Other | None
    """The next vehicle ahead in `kept_lane`: the one to follow, or the one being passed."""
    ttc_s: float
    """Time to collision with the next vehicle ahead in the ego's lane, oncoming or not; inf while the gap opens."""
    oncoming_gap_m: float
    """To the next vehicle that approaches; inf when none is in sight."""
    oncoming_closing_mps: float
    """How fast that gap shrinks; 0 when none is in sight."""
    free_lanes: tuple[int, ...]
    slow_lanes: frozenset[int]
    """Those with a slow car ahead within `CLEAR_OF_SLOW_M`: no reason to move there."""
    others: dict[int, Row]
    """Every other vehicle seen, by id."""
    neighbours: tuple[Neighbour, ...]
    """The `RELEVANT_N` nearest within `RELEVANT_M`, without the lead and the oncoming; nearest first."""

    @property
    def x_m(self) -> float:
        """The ego's centre along the road."""
        return self.ego[X]

    @property
    def kept_lane(self) -> int:
        """The lane that the passenger calls ours: the ego's, even one that ends; from a borrowed lane, `home_lane`."""
        return self.home_lane if self.borrowing else self.ego_lane

    @property
    def two_way(self) -> bool:
        return any(lane.direction == -1 for lane in self.lanes)

    @property
    def borrowing(self) -> bool:
        """The ego is in an oncoming lane."""
        return self.lanes[self.ego_lane].direction == -1

    @property
    def own_lanes(self) -> list[int]:
        """Those of our direction that are part of the road here, from the left."""
        return [lane for lane, at in enumerate(self.lanes) if at.direction == 1 and self.exists(lane)]

    def exists(self, lane: int) -> bool:
        """The lane is part of the road here."""
        return 0 <= lane < len(self.lanes) and self.lanes[lane].start_m <= self.x_m <= self.lanes[lane].end_m

    def ends(self, lane: int) -> bool:
        """The lane ends before the road does."""
        return lane_ends(lane_table(self.lanes), lane)

    def has_passed(self, identity: int | None) -> bool:
        """That vehicle lies behind the ego, with room to move in before it, or is out of sight."""
        other = None if identity is None else self.others.get(identity)
        return other is None or has_passed(self.ego, other)


def is_slow(speed_mps: float, limit_mps: float) -> bool:
    """A car at this speed holds others up."""
    return speed_mps < limit_mps - SLOWER_THAN_LIMIT_MPS


def encode_scene(observation: Observation) -> Scene:
    """Enc: the observation's rows as the few quantities that a command can be about."""
    rows = rows_of(observation).tolist()
    ego = rows[0]
    lanes = observation.lanes
    ego_lane = min(max(int(ego[LANE]), 0), len(lanes) - 1)
    home = home_lane(lane_table(lanes), ego_lane)
    kept = home if lanes[ego_lane].direction == -1 else ego_lane
    lead: Other | None = None
    ahead_m, ttc, oncoming, oncoming_closing = INF, INF, INF, 0.0
    beside: set[int] = set()
    slow: set[int] = set()
    around: dict[tuple[int, bool], tuple[Neighbour, int]] = {}
    for other in rows[1:]:
        index = min(max(int(other[LANE]), 0), len(lanes) - 1)
        gap = gap_between(ego, other)
        away = other[X] - ego[X]
        approaches = is_oncoming(other)
        if abs(away) < BESIDE_M:
            beside.add(index)
        if abs(index - ego_lane) <= 1 and not approaches:
            ahead = away >= 0.0
            apart = gap if ahead else gap_between(other, ego)
            place = (index - ego_lane, ahead)
            if apart < RELEVANT_M and (place not in around or apart < around[place][0].gap_m):
                closing = ego[VX] - other[VX] if ahead else other[VX] - ego[VX]
                around[place] = Neighbour(*place, apart, closing), int(other[ID])
        if away > 0.0 and gap < CLEAR_OF_SLOW_M and is_slow(other[VX], lanes[index].speed_limit_mps):
            slow.add(index)
        if not 0.0 < away < SIGHT_M:
            continue
        if index == ego_lane and gap < ahead_m:
            ahead_m, ttc = gap, ttc_s(gap, ego[VX] - other[VX])
        if approaches:
            if gap < oncoming:
                oncoming, oncoming_closing = gap, ego[VX] - other[VX]
        elif index == kept and (lead is None or gap < lead.gap_m):
            lead = Other(int(other[ID]), gap, other[VX])
    return Scene(
        epoch=observation.epoch,
        tick=observation.tick,
        stamp_ns=observation.stamp_ns,
        scenario=observation.scenario,
        lanes=lanes,
        ego=ego,
        speed_mps=math.hypot(ego[VX], ego[VY]),
        ego_lane=ego_lane,
        home_lane=home,
        limit_mps=lanes[ego_lane].speed_limit_mps,
        lead=lead,
        ttc_s=ttc,
        oncoming_gap_m=oncoming,
        oncoming_closing_mps=oncoming_closing,
        free_lanes=tuple(
            i for i, at in enumerate(lanes) if at.start_m <= ego[X] <= at.end_m and (i == ego_lane or i not in beside)
        ),
        slow_lanes=frozenset(slow),
        others={int(row[ID]): row for row in rows[1:]},
        neighbours=tuple(
            sorted(
                (one for one, identity in around.values() if lead is None or identity != lead.id),
                key=lambda one: one.gap_m,
            )[:RELEVANT_N]
        ),
    )


def describe(scene: Scene, delayed_by: str = "") -> str:
    """E_t as text: the road, our speed, the lead, the oncoming car, who is around, which lanes are free or end, and the
    rule by which the fast system just delayed something. Gaps in m, speeds in m/s; "closing -2": the gap grows.

    From forty to a hundred tokens, each of which costs the embedded model ten milliseconds.
    """
    lead, here = scene.lead, scene.lanes[scene.ego_lane]
    parts = [
        f"{'two-way' if scene.two_way else 'one-way'} road, lanes 0-{len(scene.lanes) - 1}, we are in {scene.ego_lane}",
        f"{scene.speed_mps:.0f} of {scene.limit_mps:.0f} m/s",
        f"car ahead {lead.gap_m:.0f} m at {lead.speed_mps:.1f} m/s, {_closing(scene.speed_mps - lead.speed_mps)}"
        if lead
        else "no car ahead",
    ]
    if math.isfinite(scene.oncoming_gap_m):
        parts.append(f"oncoming car {scene.oncoming_gap_m:.0f} m, {_closing(scene.oncoming_closing_mps)}")
    parts += map(_place, scene.neighbours)
    parts.append("free lanes " + (", ".join(map(str, scene.free_lanes)) or "none"))
    for index, lane in enumerate(scene.lanes):
        if scene.exists(index) and (lane.direction == -1 or lane.kind == "ramp"):
            parts.append(f"lane {index} is {'oncoming' if lane.direction == -1 else 'a ramp'}")
    if here.end_m - scene.x_m < LANE_ENDS_M:
        parts.append(f"our lane ends in {here.end_m - scene.x_m:.0f} m")
    if delayed_by:
        parts.append(f"just delayed: {delayed_by}")
    return "; ".join(parts)


def in_brief(scene: Scene) -> str:
    """E_t in some twenty tokens: lane of how many (from the left, of our direction), speed and limit, the car ahead,
    the oncoming one, which sides are free."""
    own = scene.own_lanes
    here = f"{own.index(scene.ego_lane) + 1}/{len(own)}" if scene.ego_lane in own else f"oncoming/{len(own)}"
    parts = [f"lane {here}", f"{scene.speed_mps:.0f}/{scene.limit_mps:.0f} mps"]
    if scene.lead is not None:
        parts.append(f"ahead {scene.lead.gap_m:.0f} m {scene.lead.speed_mps:.0f}")
    if math.isfinite(scene.oncoming_gap_m):
        parts.append(f"oncoming {scene.oncoming_gap_m:.0f} m")
    elif scene.two_way:
        parts.append("two-way")
    sides = [(name, scene.ego_lane + step) for name, step in (("left", -1), ("right", 1))]
    free = [name for name, lane in sides if lane in scene.free_lanes and scene.lanes[lane].direction == 1]
    parts.append(f"free {' '.join(free) or 'none'}")
    return ", ".join(parts)


def road_and_lead(described: str) -> str:
    """The first three parts of a description, enough for an example: road, speed, lead."""
    return "; ".join(described.split("; ")[:3])


def _closing(mps: float) -> str:
    return f"closing {round(mps)}"


def _place(one: Neighbour) -> str:
    side = {-1: "left ", 0: "", 1: "right "}[one.side]
    if one.gap_m <= 0.0:
        return f"{side}beside us"
    return f"{side}{'ahead' if one.ahead else 'behind'} {one.gap_m:.0f} m, {_closing(one.closing_mps)}"
