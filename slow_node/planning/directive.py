"""Parse and its gates (paper's Eq. 9): i_t = Parse(R_t), from the model's text to a directive that fits the road.

A directive is planned here as a draft, without ids; `issued` makes it one to send.

What must not rest on a model is decided here by rule: speed limits, safe distances, which lanes exist. Dangerous words
are in `slow_node.understanding.refusals`, spoken numbers in `slow_node.understanding.numbers`. The safety mask of the
fast node checks once more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from msgspec.structs import replace
from pydantic import ValidationError

from schemas.driving.intent import LANE_ENDS_S
from schemas.driving.measures import INF
from schemas.wire.messages import Directive, Manoeuvre, Style
from slow_node.llm.answer import json_object
from slow_node.memory.bank import Example
from slow_node.planning.replies import sentence
from slow_node.planning.scene import Scene, is_slow
from slow_node.planning.spoken import spoken, too_near
from slow_node.understanding.slots import ANSWERED, FAR_OVER_LIMIT, Outcome, Slots

SLOW_LEAD_WITHIN_M = 80.0
SLOWER_BY_MPS, SLOWEST_MPS = 2.0, 1.0
OVER_LIMIT_MPS = 0.05
"""A named speed that exceeds the limit by more than rounding: the passenger is told of the limit."""
ASKS = ("manoeuvre", "target_lane", "target_speed_mps", "headway_s", "style")
"""Fields of a directive that decide what the car does."""
CROSS_CHECK_COSINE = 0.97
CLOSER_HEADWAY_S, FARTHER_HEADWAY_S, MAX_HEADWAY_S = 1.2, 3.0, 6.0
FARTHER_BY_S = 0.5
"""More room is this much more than now, at least."""
MIN_HEADWAY_S = 1.0


class ParseError(ValueError):
    """The model's text cannot be used; `str()` says why in words that the model can act on."""


@dataclass(frozen=True)
class Refusal:
    """Why nothing is done: a reason for the log and a sentence for the passenger."""

    why: str
    say: str
    outcome: Outcome = "refused"


def parse_answer(text: str, numbers: Mapping[str, float] | None = None) -> Slots:
    """The slots in a model's text, which may wrap its JSON object in prose and add keys. Raises `ParseError`.

    numbers: slots that a directive has besides, of a model that has learnt to leave them to others.
    """
    try:
        value = json_object(text)
    except ValueError as error:
        raise ParseError(str(error)) from None
    value = {key: value[key] for key in value if key in ANSWERED}
    try:
        if numbers and value.get("outcome") == "directive":
            value = {**value, **numbers}
        slots = Slots.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        raise ParseError(f"{'.'.join(map(str, first['loc'])) or 'the object'}: {first['msg']}") from None
    if slots.outcome == "directive" and slots.is_empty():
        raise ParseError("outcome is directive, but no slot says what to do")
    return slots


UNSAFE_WHY = "unsafe command"
NOT_DRIVEN_WHY = {"refused": UNSAFE_WHY, "out_of_scope": "not about driving", "unclear": "unclear command"}
"""How the reason begins why there is no directive for an outcome."""


def cross_check(slots: Slots, nearest: Sequence[Example]) -> tuple[Slots, str]:
    """The slots to act on, and why they are not the model's ("" where they are).

    Retrieval cross-check: where a shipped example is all but the same sentence (cosine above 0.97: "in no hurry"
    is near "in a hurry") and disagrees with the model, the example is right.
    """
    shipped = [e for e in nearest if e.shipped]
    if shipped and shipped[0].cosine > CROSS_CHECK_COSINE and shipped[0].slots.decision() != slots.decision():
        why = f"retrieval cross-check: as {shipped[0].command!r} (cosine {shipped[0].cosine:.2f})"
        return shipped[0].slots.model_copy(update={"language": slots.language}), why
    return slots, ""


def directive_of(slots: Slots, scene: Scene) -> Directive | Refusal:
    """The directive for a passenger's slots on this road, or why there is none: the gate against the scene."""
    if slots.outcome != "directive":
        why = f"{NOT_DRIVEN_WHY[slots.outcome]}: {slots.reasoning}".rstrip(": ")
        return _refusal(why, slots, _SAY_OF[slots.outcome], slots.outcome, slots.say)
    home, kept = scene.home_lane, scene.kept_lane
    back = home if scene.borrowing else None
    if slots.cancel:
        return usual_directive(scene, slots.language, slots.say)
    limit = scene.lanes[home].speed_limit_mps
    if slots.target_speed_mps is not None and slots.target_speed_mps > FAR_OVER_LIMIT * limit:
        return _refusal(f"{slots.target_speed_mps:.0f} m/s is far over the limit", slots, "unsafe")
    if slots.gap == "closer" and _only_gap(slots) and (near := too_near(scene, CLOSER_HEADWAY_S, slots)):
        return _refusal("as close as is safe already", slots, "", say=near)
    if slots.headway_s is not None and slots.headway_s < MIN_HEADWAY_S:
        return _refusal(f"{slots.headway_s:.1f} s is no safe distance", slots, "unsafe")
    if slots.speed == "stop":
        return _draft(scene, "stop", back, 0.0, style="calm", say=_say(slots, "stop"))
    if slots.lane == "keep" and not scene.borrowing and not may_take(scene, kept):
        return _refusal("this lane ends", slots, "no_lane")
    on_left_is_oncoming = scene.exists(kept - 1) and scene.lanes[kept - 1].direction == -1
    pass_left = slots.lane in ("left", "leftmost") and on_left_is_oncoming
    hurry = hurried(slots) and scene.two_way
    to_pass = slow_lead(scene, INF) if slots.overtake else slow_lead(scene) and (pass_left or hurry)
    if slots.overtake is not False and to_pass:
        return _overtake(slots, scene)
    if pass_left and not scene.borrowing:
        return _refusal("the left lane is oncoming, with no slow car to pass", slots, "oncoming")
    lane = _target_lane(slots, scene)
    if isinstance(lane, Refusal):
        return lane
    keeps_place = slots.overtake is False or (slots.speed == "keep" and scene.speed_mps < SLOWEST_MPS)
    if lane is None and (slots.lane == "keep" or (keeps_place and may_take(scene, kept))):
        lane = kept
    if lane is None:
        lane = back
    speed = _target_speed(slots, scene, lane)
    headway = _headway(slots, scene)
    manoeuvre: Manoeuvre = "cruise" if headway is None and slots.overtake is not False else "follow"
    if lane is None and speed is None and headway is None and slots.gap != "keep" and slots.overtake is not False:
        return _refusal("the answer asks for nothing", slots, "unclear", "unclear")
    style: Style = "calm" if slots.speed == "slower" or slots.gap == "farther" else "normal"
    return _draft(scene, manoeuvre, lane, speed, headway, style, _told(slots, scene, _key(slots), lane, speed, headway))


def _only_gap(slots: Slots) -> bool:
    return slots.speed == "none" and slots.lane == "none" and slots.overtake is None and slots.target_speed_mps is None


def hurried(slots: Slots) -> bool:
    """Asked to get on, with no speed, other lane or place in the queue named: it does not end with the next car."""
    return (
        slots.outcome == "directive"
        and slots.speed == "faster"
        and slots.lane in ("none", "left")
        and slots.target_speed_mps is None
        and slots.overtake is not False
    )


def onward_directive(slots: Slots, scene: Scene) -> Directive | Refusal:
    """A hurry that goes on after its first success: pass the next slow car, whatever was said about the first."""
    return directive_of(slots.model_copy(update={"lane": "none", "overtake": True, "say": ""}), scene)


def usual_directive(scene: Scene, language: str = "en", say: str = "") -> Directive:
    """Back to normal driving, which is never refused; said in this sentence, or in ours."""
    return _draft(scene, "cruise", say=say or sentence("cancel", language))


def right_directive(scene: Scene, language: str = "en") -> Directive:
    """One lane to the right again, on a one-way road, at the limit."""
    right = scene.home_lane + 1
    return _draft(scene, "cruise", right, _cap(scene, right), say=sentence("right", language))


def on_this_road(directive: Directive, scene: Scene) -> Directive:
    """One made elsewhere on the road: without a lane that has ended since, within the limit here; not said again."""
    lane = directive.target_lane
    if (
        lane is not None
        and not may_take(scene, lane)
        and not (directive.manoeuvre == "overtake" and scene.exists(lane) and scene.lanes[lane].direction == -1)
    ):
        lane = None
    speed = directive.target_speed_mps
    return replace(
        directive, target_lane=lane, target_speed_mps=None if speed is None else min(speed, _cap(scene, lane)), say=""
    )


def issued(
    draft: Directive, scene: Scene, command_id: int, directive_id: int, reasoning: str, now_ns: int
) -> Directive:
    """The directive to send: a draft, or another one once more, with the ids and the time of now."""
    return replace(
        draft,
        epoch=scene.epoch,
        stamp_ns=now_ns,
        id=directive_id,
        command_id=command_id,
        scene_tick=scene.tick,
        reasoning=reasoning,
    )


def asks_the_same(one: Directive, other: Directive) -> bool:
    """Whether two directives ask the fast node for the same thing."""
    return all(getattr(one, name) == getattr(other, name) for name in ASKS)


def may_take(scene: Scene, lane: int) -> bool:
    """A lane to be sent to: it is there, in our direction, no ramp, and does not end within `LANE_ENDS_S`."""
    if not scene.exists(lane):
        return False
    at = scene.lanes[lane]
    ends = scene.ends(lane) and at.end_m - scene.x_m < LANE_ENDS_S * scene.speed_mps
    return at.direction == 1 and at.kind != "ramp" and not ends


def slow_lead(scene: Scene, within_m: float = SLOW_LEAD_WITHIN_M) -> bool:
    """A car to overtake: ahead in the ego's own lane, slower than the limit, and near, unless it was asked for."""
    lead = scene.lead
    return lead is not None and lead.gap_m < within_m and is_slow(lead.speed_mps, _cap(scene, None))


def return_directive(scene: Scene, language: str = "en") -> Directive:
    """The second half of an overtaking manoeuvre: back to the ego's own side of the road."""
    say = sentence("back", language)
    return _draft(scene, "overtake", scene.home_lane, _cap(scene, scene.home_lane), style="assertive", say=say)


def _draft(
    scene: Scene,
    manoeuvre: Manoeuvre,
    lane: int | None = None,
    speed_mps: float | None = None,
    headway_s: float | None = None,
    style: Style = "normal",
    say: str = "",
) -> Directive:
    return Directive(
        epoch=scene.epoch,
        stamp_ns=scene.stamp_ns,
        id=0,
        command_id=0,
        scene_tick=scene.tick,
        manoeuvre=manoeuvre,
        target_lane=lane,
        target_speed_mps=speed_mps,
        headway_s=headway_s,
        style=style,
        say=say,
    )


_SAY_OF = {"refused": "unsafe", "out_of_scope": "out_of_scope", "unclear": "unclear"}


def _refusal(why: str, slots: Slots, key: str, outcome: Outcome = "refused", say: str = "") -> Refusal:
    return Refusal(why, say or sentence(key, slots.language), outcome)


def _say(slots: Slots, key: str) -> str:
    """The model's sentence or ours."""
    return slots.say or sentence(key, slots.language)


def _told(
    slots: Slots, scene: Scene, key: str, lane: int | None, speed: float | None, headway: float | None = None
) -> str:
    """The model's sentence or ours; where a named speed is cut to the limit always ours, which says so."""
    if slots.target_speed_mps is not None and slots.target_speed_mps > _cap(scene, lane) + OVER_LIMIT_MPS:
        return spoken(slots, scene, "limit", lane, speed, headway)
    return slots.say or spoken(slots, scene, key, lane, speed, headway)


def _overtake(slots: Slots, scene: Scene) -> Directive | Refusal:
    kept = scene.kept_lane
    sides = [kept - 1, kept + 1] if not scene.two_way else [kept - 1]
    if slots.lane in ("right", "rightmost"):
        sides.reverse()
    for lane in sides:
        if may_take(scene, lane) or (scene.exists(lane) and scene.lanes[lane].direction == -1):
            cap = _cap(scene, lane)
            say = _told(slots, scene, "overtake", lane, cap)
            return _draft(scene, "overtake", lane, cap, style="assertive", say=say)
    return _refusal("there is no lane to overtake in", slots, "no_lane")


def _cap(scene: Scene, lane: int | None) -> float:
    """The most that a directive may ask for in a lane."""
    return scene.lanes[scene.home_lane if lane is None else lane].speed_limit_mps


def _target_lane(slots: Slots, scene: Scene) -> int | Refusal | None:
    """The lane that was named. From a borrowed lane, right is the way home and left is farther into the traffic."""
    if slots.to_lane is not None:
        if scene.exists(slots.to_lane) and scene.lanes[slots.to_lane].direction == -1:
            return _refusal(f"lane {slots.to_lane} is oncoming", slots, "oncoming")
        if not may_take(scene, slots.to_lane):
            return _refusal("no such lane", slots, "no_lane")
        return slots.to_lane
    if slots.lane in ("left", "right"):
        lane = scene.ego_lane + (-1 if slots.lane == "left" else 1)
        if scene.borrowing and slots.lane == "right":
            return scene.home_lane
        if scene.exists(lane) and scene.lanes[lane].direction == -1:
            return _refusal(f"the lane to the {slots.lane} is oncoming", slots, "oncoming")
        if not may_take(scene, lane):
            return _refusal(f"no lane to the {slots.lane}", slots, "no_lane")
        return lane
    if slots.lane in ("leftmost", "rightmost"):
        own = [lane for lane in range(len(scene.lanes)) if may_take(scene, lane)]
        if not own:
            return _refusal(f"no {slots.lane} lane", slots, "no_lane")
        return own[0] if slots.lane == "leftmost" else own[-1]
    return None


def _target_speed(slots: Slots, scene: Scene, lane: int | None) -> float | None:
    """Between standstill and the limit; slower is never faster than now. Who stands and is to go on as before has no
    speed to keep: the fast node knows the one before the stop."""
    cap = _cap(scene, lane)
    if slots.target_speed_mps is not None:
        return min(slots.target_speed_mps, cap)
    if slots.speed == "faster" or slots.overtake:
        return cap
    if slots.speed == "slower":
        return min(max(scene.speed_mps - SLOWER_BY_MPS, SLOWEST_MPS), scene.speed_mps, cap)
    if slots.speed == "keep" and scene.speed_mps >= SLOWEST_MPS:
        return min(scene.speed_mps, cap)
    return None


def _headway(slots: Slots, scene: Scene) -> float | None:
    """Time gap [s] behind the lead; a wish to keep it means the one we have now, within what is safe."""
    if slots.headway_s is not None:
        return min(max(slots.headway_s, CLOSER_HEADWAY_S), MAX_HEADWAY_S)
    if slots.gap == "keep":
        if scene.lead is None or scene.speed_mps < 1.0:
            return None
        return min(max(scene.lead.gap_m / scene.speed_mps, CLOSER_HEADWAY_S), FARTHER_HEADWAY_S)
    if slots.gap == "farther" and scene.lead is not None and scene.speed_mps >= 1.0:
        return min(max(FARTHER_HEADWAY_S, scene.lead.gap_m / scene.speed_mps + FARTHER_BY_S), MAX_HEADWAY_S)
    return {"closer": CLOSER_HEADWAY_S, "farther": FARTHER_HEADWAY_S}.get(slots.gap)


def _key(slots: Slots) -> str:
    """Which sentence describes the slots best."""
    if slots.lane != "none":
        return {"leftmost": "left", "rightmost": "right", "keep": "keep_lane"}.get(slots.lane, slots.lane)
    if slots.overtake is False:
        return "stay_behind"
    if slots.overtake and slots.target_speed_mps is None:
        return "nobody_ahead"
    if slots.gap != "none" or slots.headway_s is not None:
        return {"farther": "farther", "closer": "closer"}.get(slots.gap, "keep_gap")
    return slots.speed if slots.speed != "none" else "speed"
