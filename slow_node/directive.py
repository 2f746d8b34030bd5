"""Parse and its gates (paper's Eq. 8): i_t = Parse(R_t), from the model's text to a directive that fits the road.

What must not rest on a model is decided here by rule: dangerous commands, spoken numbers, speed limits, which lanes
exist. The safety mask of the fast node checks once more, at every tick.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import ValidationError

from schemas.messages import Manoeuvre, Style
from slow_node.memory import Example
from slow_node.scene import Scene
from slow_node.slots import Slots

SLOW_LEAD_WITHIN_M = 80.0
TWO_WAY_SPEED_MPS = 8.0
SLOWER_BY_MPS, SLOWEST_MPS = 2.0, 1.0
CROSS_CHECK_COSINE = 0.9
CLOSER_HEADWAY_S, FARTHER_HEADWAY_S = 1.2, 3.0


class ParseError(ValueError):
    """The model's text cannot be used; `str()` says why in words that the model can act on."""


@dataclass(frozen=True)
class Plan:
    """The part of a directive that the road and the wish decide."""

    manoeuvre: Manoeuvre
    target_lane: int | None = None
    target_speed_mps: float | None = None
    headway_s: float | None = None
    style: Style = "normal"
    say: str = ""


@dataclass(frozen=True)
class Refusal:
    """Why nothing is done: a reason for the log and a sentence for the passenger."""

    why: str
    say: str


def parse_answer(text: str) -> Slots:
    """The slots in a model's text, which may wrap its JSON object in prose. Raises `ParseError`."""
    start = text.find("{")
    if start < 0:
        raise ParseError("it contains no JSON object")
    try:
        value, _ = json.JSONDecoder().raw_decode(text, start)
    except (ValueError, RecursionError):
        raise ParseError("its JSON object is broken or cut off") from None
    try:
        slots = Slots.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        raise ParseError(f"{'.'.join(map(str, first['loc'])) or 'the object'}: {first['msg']}") from None
    if slots.outcome == "directive" and slots.wishes_nothing():
        raise ParseError("outcome is directive, but no slot says what to do")
    return slots


_HARM = re.compile(
    r"\b(ram(m|me|s|ming)?|crash(es|ing)? (it |us )?(in ?to|against)|smash|run (him|her|them|it|\w+ \w+) over|run over|"
    r"hit (the|that|this|him|her|them|a|my|those)\b|kill|hurt (him|her|them|the|that|some)|"
    r"(push|force|shove) \w+( \w+)? off|cut (him|her|them|that \w+) off|(into|towards?) (the )?oncoming|collide|"
    r"wrong way|on the (sidewalk|pavement)|run (the|this|that|a) red|"
    r"(ignore|forget|break|disregard|exceed) (the |all |every |your )*(speed limits?|limit|rules?|law|safety|red light|"
    r"other (cars|vehicles)|traffic)|(switch|turn) off (the |all |your )*(safety|brakes?|mask)|"
    r"disable (the |all |your )*(safety|brakes?|mask)|without (braking|looking)|eyes closed|scare (the|that|him|her)|"
    r"floor it)\b",
    re.IGNORECASE,
)
_NEGATION = re.compile(
    r"\b(do ?n[o']t|don\u2019t|dont|never|avoid|without|not|no need to)\b[^.,;!?]{0,25}$", re.IGNORECASE
)


def unsafe(command: str) -> bool:
    """The command asks for harm in so many words. Judged before any model, and whatever a model says."""
    return any(not _NEGATION.search(command[: match.start()]) for match in _HARM.finditer(command))


UNSAFE = Refusal("unsafe command", "I cannot do that: it would put people at risk.")

_SPEED = re.compile(
    r"(?<![\d.])(\d{1,3}(?:[.,]\d{1,2})?)\s*(m/s|mps|met(?:er|re)s? per second"
    r"|km/?h|kph|kilomet\w+ (?:per|an) hour|mph)",
    re.IGNORECASE,
)


def spoken_speed_mps(command: str) -> float | None:
    """A speed that the passenger named with its unit, as a rule: small models invent numbers."""
    match = _SPEED.search(command)
    if match is None:
        return None
    value, unit = float(match[1].replace(",", ".")), match[2].lower()
    if unit == "mph":
        return value * 0.44704
    return value / 3.6 if unit.startswith("k") else value


def cross_check(command: str, slots: Slots, nearest: Sequence[Example]) -> tuple[Slots, str]:
    """The slots to act on, and why they are not the model's ("" where they are).

    Retrieval cross-check: where a shipped example is all but the same sentence (cosine above 0.9) and disagrees with
    the model, the example is right. Speeds come from the passenger's own digits, or not at all.
    """
    why = ""
    seeds = [e for e in nearest if e.seed]
    if seeds and seeds[0].cosine > CROSS_CHECK_COSINE and seeds[0].slots.decision() != slots.decision():
        why = f"retrieval cross-check: as {seeds[0].command!r} (cosine {seeds[0].cosine:.2f})"
        slots = seeds[0].slots
    spoken = spoken_speed_mps(command)
    if spoken is not None:
        return slots.model_copy(update={"target_speed_mps": min(spoken, 100.0)}), why
    if not any(c.isdigit() for c in command) and slots.target_speed_mps is not None:
        return slots.model_copy(update={"target_speed_mps": None}), why
    return slots, why


def plan_of(slots: Slots, scene: Scene) -> Plan | Refusal:
    """The directive's content for a wish on this road, or why there is none: the gate against the scene."""
    if slots.outcome == "refuse":
        return Refusal(f"refused: {slots.reasoning}".rstrip(": "), slots.say or "I can only help with safe driving.")
    if slots.outcome == "unclear":
        return Refusal("unclear command", slots.say or "I did not understand. How should I drive?")
    home = scene.home_lane
    back = home if scene.borrowing else None
    if slots.cancel:
        return Plan("cruise", back, say=slots.say or "All right, back to normal driving.")
    if slots.speed == "stop":
        return Plan("stop", back, 0.0, style="calm", say=slots.say or "I will stop.")
    on_left_is_oncoming = scene.exists(home - 1) and scene.lanes[home - 1].direction == -1
    hurry = slots.speed == "faster" and slots.lane in ("none", "left") and slots.target_speed_mps is None
    pass_left = slots.lane == "left" and on_left_is_oncoming
    if _slow_lead(scene) and (slots.overtake or pass_left or (hurry and scene.two_way)):
        return _overtake(slots, scene)
    if pass_left and not scene.borrowing:
        return Refusal("the left lane is oncoming, with no slow car to pass", "The left lane is for oncoming traffic.")
    lane = _wished_lane(slots, scene)
    if isinstance(lane, Refusal):
        return lane
    if lane is None:
        lane = back
    speed = _wished_speed(slots, scene, lane)
    headway = {"closer": CLOSER_HEADWAY_S, "farther": FARTHER_HEADWAY_S}.get(slots.gap)
    manoeuvre: Manoeuvre = "cruise" if headway is None else "follow"
    if lane is None and speed is None and headway is None and slots.lane != "keep":
        return Refusal("the answer asks for nothing", "I did not understand. How should I drive?")
    if slots.lane == "keep":
        lane = home
    style: Style = "calm" if slots.speed == "slower" or slots.gap == "farther" else "normal"
    return Plan(manoeuvre, lane, speed, headway, style, slots.say or _sentence(slots))


def return_plan(scene: Scene) -> Plan:
    """The second half of an overtaking manoeuvre: back to the ego's own side of the road."""
    return Plan("overtake", scene.home_lane, _cap(scene, scene.home_lane), style="assertive", say="Moving back in.")


def _overtake(slots: Slots, scene: Scene) -> Plan | Refusal:
    home = scene.home_lane
    sides = [home - 1, home + 1] if not scene.two_way else [home - 1]
    for lane in sides:
        if scene.exists(lane) and scene.lanes[lane].kind != "ramp":
            say = slots.say or "I will overtake as soon as it is safe."
            return Plan("overtake", lane, _cap(scene, lane), style="assertive", say=say)
    return Refusal("there is no lane to overtake in", "There is no lane here to overtake in.")


def _slow_lead(scene: Scene) -> bool:
    lead = scene.lead
    return lead is not None and lead.gap_m < SLOW_LEAD_WITHIN_M and lead.speed_mps < _cap(scene, scene.home_lane) - 0.5


def _cap(scene: Scene, lane: int | None) -> float:
    """The most that a directive may ask for in a lane."""
    limit = scene.lanes[scene.home_lane if lane is None else lane].speed_limit_mps
    return min(limit, TWO_WAY_SPEED_MPS) if scene.scenario == "two-way" else limit


def _wished_lane(slots: Slots, scene: Scene) -> int | Refusal | None:
    if slots.lane not in ("left", "right"):
        return None
    lane = scene.ego_lane + (-1 if slots.lane == "left" else 1)
    if not scene.exists(lane):
        return Refusal(f"no lane to the {slots.lane}", f"There is no lane to our {slots.lane}.")
    return lane


def _wished_speed(slots: Slots, scene: Scene, lane: int | None) -> float | None:
    cap = _cap(scene, lane)
    if slots.target_speed_mps is not None:
        return min(slots.target_speed_mps, scene.lanes[scene.home_lane if lane is None else lane].speed_limit_mps)
    if slots.speed == "faster" or slots.overtake:
        return cap
    if slots.speed == "slower":
        return min(max(scene.speed_mps - SLOWER_BY_MPS, SLOWEST_MPS), cap)
    if slots.speed == "keep":
        return min(scene.speed_mps, cap)
    return None


def _sentence(slots: Slots) -> str:
    if slots.lane in ("left", "right"):
        return f"Moving to the {slots.lane} lane when it is safe."
    if slots.gap != "none":
        return "I will keep more distance." if slots.gap == "farther" else "I will follow a little closer."
    return {"faster": "I will drive faster.", "slower": "Slowing down."}.get(slots.speed, "All right.")
