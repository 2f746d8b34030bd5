"""What will happen, in the passenger's words and units: the sentence of a directive, with its numbers."""

from __future__ import annotations

from schemas.driving.measures import INF
from slow_node.planning.replies import sentence, spoken_length, spoken_speed
from slow_node.planning.scene import Other, Scene, is_slow
from slow_node.understanding.slots import Slots

BOXED_S = 2.5
"""A car ahead within this time gap, and no lane beside it free: boxed in."""
AT_LIMIT_MPS = 0.5


def spoken(
    slots: Slots, scene: Scene, key: str, lane: int | None, speed_mps: float | None, headway_s: float | None = None
) -> str:
    """The sentence for a directive; `key` says which one describes it, where nothing stands against it."""
    miles, lead = slots.miles, scene.lead
    limit = scene.lanes[scene.home_lane].speed_limit_mps
    speed = limit if speed_mps is None else speed_mps
    if key == "faster" and slots.target_speed_mps is None:
        if boxed_in(scene):
            key = "boxed_in"
        elif scene.speed_mps >= speed - AT_LIMIT_MPS:
            key = "at_limit"
    if key in ("farther", "closer", "keep_gap") and lead is None:
        key = "gap_nobody"
    if key in ("left", "right") and slots.to_lane is not None and lane is not None:
        key = "lane_n"
    return sentence(
        key,
        slots.language,
        speed=spoken_speed(speed, miles),
        lead=spoken_speed(lead.speed_mps if lead else 0.0, miles),
        seconds=f"{headway_s or 0.0:.1f}",
        gap=spoken_length((headway_s or 0.0) * scene.speed_mps, miles),
        **place(scene, lane),
    )


def boxed_in(scene: Scene) -> bool:
    """A slow car is close ahead, and no lane of our direction beside it is free."""
    lead: Other | None = scene.lead
    if lead is None or scene.two_way or not is_slow(lead.speed_mps, scene.limit_mps):
        return False
    if lead.gap_m > BOXED_S * max(scene.speed_mps, 1.0):
        return False
    own, here = scene.own_lanes, scene.ego_lane
    return not any(lane in own and lane in scene.free_lanes for lane in (here - 1, here + 1))


def too_near(scene: Scene, closest_s: float, slots: Slots) -> str:
    """Why no closer: we are as close as is safe already; "" where we are not."""
    lead = scene.lead
    seconds = INF if lead is None or scene.speed_mps < 1.0 else lead.gap_m / scene.speed_mps
    if lead is None or seconds > closest_s:
        return ""
    gap = spoken_length(max(lead.gap_m, 0.0), slots.miles)
    return sentence("as_close", slots.language, gap=gap, seconds=f"{max(seconds, 0.0):.1f}")


def place(scene: Scene, lane: int | None = None) -> dict[str, str]:
    """A lane's number among those of our direction, from the left, and how many there are; the ego's by default."""
    own = scene.own_lanes
    here = scene.kept_lane if lane is None else lane
    return {"lane": str(own.index(here) + 1 if here in own else 1), "lanes": str(max(len(own), 1))}
