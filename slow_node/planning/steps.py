"""A program's steps on the road as it is now: which belong together, and what they ask for in slots."""

from __future__ import annotations

from msgspec.structs import replace

from schemas.wire.program import Program, Step, Trigger
from slow_node.planning.directive import MAX_HEADWAY_S, MIN_HEADWAY_S, may_take
from slow_node.planning.scene import Scene
from slow_node.understanding.reading.values import A_BIT_MPS
from slow_node.understanding.slots import LaneSlot, Slots

USUAL_HEADWAY_S = 1.5
"""The gap that is changed where nobody is ahead."""
YIELDING_S = 2.5
"""The gap that lets somebody in."""
LEFT_BEHIND_MPS = 3.0
"""Who makes way drives this much more slowly."""

Stage = tuple[Step, ...]
"""Steps that begin together."""


def stages(program: Program) -> tuple[Stage, ...]:
    """A program's steps, those together that begin together."""
    found: list[list[Step]] = []
    for step in program.steps:
        if not found or step.when is not None:
            found.append([])
        found[-1].append(step)
    return tuple(tuple(stage) for stage in found)


def ends(stage: Stage) -> Trigger | None:
    """Until when a stage lasts."""
    return next((step.until for step in stage if step.until is not None), None)


def slots_of(stage: Stage, scene: Scene, language: str, miles: bool = False) -> Slots:
    """What a stage asks for on this road: changes and multiples become values, lanes by number become those lanes."""
    asked: dict[str, object] = {}
    for step in stage:
        asked |= _asked(step, scene)
    return Slots.model_validate({"outcome": "directive", "language": language, "miles": miles, **asked})


def _asked(step: Step, scene: Scene) -> dict[str, object]:
    match step.act:
        case "drive" | "faster" | "slower":
            return _speed(step, scene)
        case "smoother":
            return {"speed": "slower"}
        case "stop":
            return {"speed": "stop"}
        case "keep":
            slot = step.object if step.object in ("speed", "lane", "gap") else "speed"
            return {slot: "keep"}
        case "lane":
            return _lane(step, scene)
        case "gap" | "closer" | "farther":
            return _gap(step, scene)
        case "overtake":
            return {"overtake": step.polarity == "do"}
        case "yield":
            return _yielding(step, scene)
        case "cancel":
            return {"cancel": True}
        case _:
            return {}


def _speed(step: Step, scene: Scene) -> dict[str, object]:
    asked: dict[str, object] = {} if step.act == "drive" else {"speed": step.act}
    if step.polarity == "not":
        return {"speed": "keep"}
    if step.object == "limit" and step.value is None:
        within = min(scene.speed_mps, scene.limit_mps) if step.mode == "at_most" else scene.limit_mps
        return {"target_speed_mps": within}
    value, now, mode = step.value, scene.speed_mps, step.mode
    if step.object == "bit" and value is None:
        value, mode = A_BIT_MPS, "by"
    if value is None:
        return asked
    if mode == "by":
        value = max(now + (value if step.act == "faster" else -value), 0.0)
    elif mode == "factor":
        value = now * value
    elif mode == "at_least":
        value = max(value, min(now, scene.limit_mps))
    if value <= 0.0:
        return {"speed": "stop"}
    return {**asked, "target_speed_mps": min(value, 1000.0)}


def _lane(step: Step, scene: Scene) -> dict[str, object]:
    if step.polarity == "not":
        return {"lane": "keep"}
    here = scene.ego_lane
    if step.side == "either":
        sides = [lane for lane in (here - 1, here + 1) if may_take(scene, lane)]
        free = [lane for lane in sides if lane in scene.free_lanes]
        return _to((free or sides or [here - 1])[0], scene)
    if step.object == "middle":
        own = _own(scene)
        return _to(own[len(own) // 2], scene) if own else {"lane": "keep"}
    if step.side in ("left", "right"):
        count = step.count or 1
        return {"lane": step.side} if count == 1 else _to(here + (-count if step.side == "left" else count), scene)
    if step.count is None:
        return {"lane": step.side}
    own = scene.own_lanes
    if step.count > len(own):
        return {"lane": "right" if step.side != "rightmost" else "left", "to_lane": len(scene.lanes)}
    return _to(own[-step.count if step.side == "rightmost" else step.count - 1], scene)


def _own(scene: Scene) -> list[int]:
    return [lane for lane in range(len(scene.lanes)) if may_take(scene, lane)]


def _to(lane: int, scene: Scene) -> dict[str, object]:
    """An absolute lane, with the slot that says it best."""
    own, here = _own(scene), scene.ego_lane
    if lane == here:
        return {"lane": "keep"}
    name: LaneSlot = "left" if lane < here else "right"
    if abs(lane - here) > 1 and own and lane == (own[0] if lane < here else own[-1]):
        name = "leftmost" if lane < here else "rightmost"
    return {"lane": name, "to_lane": max(lane, -1)}


def headway_now_s(scene: Scene) -> float:
    """The time gap to the car ahead [s]; the usual one where there is none."""
    if scene.lead is None or scene.speed_mps < 1.0:
        return USUAL_HEADWAY_S
    return max(scene.lead.gap_m, 0.0) / scene.speed_mps


def _gap(step: Step, scene: Scene) -> dict[str, object]:
    asked: dict[str, object] = {} if step.act == "gap" else {"gap": step.act}
    if step.value is None:
        return asked
    now, speed = headway_now_s(scene), max(scene.speed_mps, 1.0)
    if step.unit == "times":
        headway = now * step.value
    else:
        amount = step.value / speed if step.unit == "m" else step.value
        headway = amount
        if step.mode == "by":
            headway = now + (amount if step.act == "farther" else -amount)
            return {**asked, "headway_s": min(max(headway, MIN_HEADWAY_S), MAX_HEADWAY_S)}
        if step.mode == "at_least":
            headway = max(amount, min(now, MAX_HEADWAY_S)) if scene.lead is not None else amount
    if step.unit == "times":
        headway = min(max(headway, MIN_HEADWAY_S), MAX_HEADWAY_S)
    return {**asked, "headway_s": min(headway, 60.0)}


def _yielding(step: Step, scene: Scene) -> dict[str, object]:
    """Room for who comes in ahead; for who comes from behind the lane to the right, where there is one."""
    if step.polarity == "not":
        return {"gap": "keep"}
    if step.side == "right":
        slower = {"speed": "slower", "target_speed_mps": max(scene.speed_mps - LEFT_BEHIND_MPS, 0.5 * scene.speed_mps)}
        return {**slower, "lane": "right"} if may_take(scene, scene.ego_lane + 1) else {**slower, "lane": "keep"}
    return {"gap": "farther", "headway_s": max(YIELDING_S, min(headway_now_s(scene), MAX_HEADWAY_S))}


def summary(program: Program, scene: Scene, language: str) -> Slots:
    """A program in slots, as the labelled sets have them: every step; of a multiple or a changed gap the word."""
    if program.outcome != "directive" or not program.steps:
        return Slots(outcome="unclear" if program.outcome == "directive" else program.outcome, language=language)
    asked: dict[str, object] = {}
    for step in program.steps:
        wordy = step.mode == "factor" or (step.mode == "by" and step.unit in ("m", "s")) or step.act == "yield"
        asked |= _asked(replace(step, value=None, unit=None, mode=None) if wordy else step, scene)
        if wordy:
            asked.pop("headway_s", None)
            asked.pop("target_speed_mps", None)
    return Slots.model_validate({"outcome": "directive", "language": language, **asked})
