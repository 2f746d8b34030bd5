"""The language model alone at the wheel, once a second: the baseline after the published method of DiLu.

Wen et al. 2023, "DiLu: A Knowledge-Driven Approach to Autonomous Driving with Large Language Models" (arXiv
2309.16292): the scene in words, the most similar experiences of a memory as few-shot examples, reasoning in words that
ends with the id of one action. Written from the paper's method. Departures: terse sentences, for every token costs a
small model ten milliseconds; the actions are listed once, and a lane that cannot be reached is said to be none; the
memory is fixed, for their reflection, which adds corrected failures between episodes, takes a model that can judge its
own driving; an answer without an id is not asked about again.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from schemas.driving.road import LANE, VX, X, gap_between
from schemas.wire.codec import rows_of
from schemas.wire.messages import Lane, MetaAction, Observation
from slow_node.llm.dialect import Chat
from slow_node.llm.embedding import Embedder

FEW_SHOTS = 3
"""Experiences in a prompt: their `few_shot_num`."""
SEEN_AHEAD_M, SEEN_BEHIND_M = 120.0, 50.0
"""Cars farther away are not mentioned."""
NEAR_S = 3.0
"""A car ahead within this time headway is a reason to act."""
LANE_ENDS_M = 300.0
SAME_SPEED_MPS = 0.5
ANSWER = "Response to user:####"
WORDS = {
    MetaAction.SLOW_DOWN: "slow down",
    MetaAction.CRUISE: "keep lane and speed",
    MetaAction.SPEED_UP: "speed up",
    MetaAction.LEFT: "change left",
    MetaAction.RIGHT: "change right",
}
_ACTIONS = ", ".join(f"{int(action)} {words}" for action, words in WORDS.items())
SYSTEM = f"""You drive a car. Every second choose one action: {_ACTIONS}. The passenger is in a hurry: go fast, pass \
slow cars, leave a lane that ends, but never collide. Gaps are in m, speeds in m/s. Reason briefly, then end with \
"{ANSWER} <action id>"."""

_ID = re.compile(re.escape(ANSWER) + r"\s*([0-4])(?!\d)")

Row = list[float]
"""A vehicle: `ROW_COLUMNS`."""


@dataclass(frozen=True)
class Experience:
    """One decision to learn from: the scene as `describe` words it, why, and what was done."""

    scene: str
    reasoning: str
    action: MetaAction

    @property
    def answer(self) -> str:
        """The answer as the model is to give it."""
        return f"{self.reasoning}\n{ANSWER} {int(self.action)}"


class Bank:
    """A fixed memory of experiences, retrieved by the cosine of their scenes' sentence embeddings."""

    def __init__(self, embedder: Embedder, experiences: Sequence[Experience]) -> None:
        """Raises ValueError for an empty memory: the examples are what teaches the model how to answer."""
        if not experiences:
            raise ValueError("the memory holds no experience")
        self._embedder = embedder
        self._experiences = tuple(experiences)
        self._vectors = np.stack([embedder.embed(e.scene) for e in experiences])

    def nearest(self, scene: str, k: int = FEW_SHOTS) -> list[Experience]:
        """The k experiences most similar to a scene, best first."""
        order = np.argsort(-(self._vectors @ self._embedder.embed(scene)), kind="stable")
        return [self._experiences[i] for i in order[:k]]


def build_prompt(scene: str, experiences: Sequence[Experience]) -> Chat:
    """Role, examples and scene as a chat. The best example comes last, where a small model attends to it most."""
    chat: Chat = [{"role": "system", "content": SYSTEM}]
    for experience in reversed(experiences):
        chat.append({"role": "user", "content": experience.scene})
        chat.append({"role": "assistant", "content": experience.answer})
    chat.append({"role": "user", "content": scene})
    return chat


def parse(answer: str) -> MetaAction | None:
    """The action of the last `Response to user:#### <id>` in an answer; None where there is none."""
    found = _ID.findall(answer)
    return MetaAction(int(found[-1])) if found else None


def describe(observation: Observation) -> str:
    """The scene in words: the ego, the car ahead of it, and who is where in the lanes that it could change to."""
    rows = rows_of(observation).tolist()
    lanes, ego = observation.lanes, rows[0]
    lane = _lane(ego, lanes)
    here = lanes[lane]
    parts = [f"{len(lanes)} lanes, you are in lane {lane}, {ego[VX]:.0f} of {here.speed_limit_mps:.0f} m/s"]
    rising = observation.target_speed_mps - ego[VX]
    if abs(rising) > SAME_SPEED_MPS:
        parts[0] += ", speeding up" if rising > 0 else ", slowing down"
    if observation.previous_lane >= 0:
        parts.append(f"Changing to lane {observation.target_lane}")
    if here.direction < 0:
        parts.append("This lane is for oncoming cars")
    left = here.end_m - ego[X]
    if left < LANE_ENDS_M:
        parts.append(f"Lane ends in {max(left, 0.0):.0f}")
    ahead, _ = _neighbours(rows, lane, lanes)
    parts.append(f"Your lane: {_car(ego, ahead) if ahead else 'clear'}")
    for name, index in (("Left", lane - 1), ("Right", lane + 1)):
        parts.append(f"{name}: {_beside(rows, lanes, lane, index)}")
    return ". ".join(parts) + "."


def explain(observation: Observation, action: MetaAction) -> str:
    """Why somebody would do this here, in one sentence: the reasoning of an experience that nobody wrote."""
    rows = rows_of(observation).tolist()
    lanes, ego = observation.lanes, rows[0]
    lane = _lane(ego, lanes)
    ahead, _ = _neighbours(rows, lane, lanes)
    if lanes[lane].direction < 0:
        why = "I am in the oncoming lane"
    elif lanes[lane].end_m - ego[X] < LANE_ENDS_M:
        why = "My lane ends"
    elif ahead is None or _gap(ego, ahead) > NEAR_S * max(ego[VX], 1.0):
        why = "No car is near ahead"
    elif ahead[VX] < ego[VX] - SAME_SPEED_MPS:
        why = "The car ahead is slower"
    else:
        why = "The car ahead is not slower"
    return f"{why}, so {WORDS[action]}: action {int(action)}."


def _lane(row: Row, lanes: Sequence[Lane]) -> int:
    return min(max(int(row[LANE]), 0), len(lanes) - 1)


def _exists(lanes: Sequence[Lane], index: int, x: float) -> bool:
    return 0 <= index < len(lanes) and lanes[index].start_m <= x <= lanes[index].end_m


def _gap(ego: Row, other: Row) -> float:
    """Bumper to bumper, whichever is in front; negative beside each other."""
    rear, front = (ego, other) if other[X] >= ego[X] else (other, ego)
    return gap_between(rear, front)


def _neighbours(rows: list[Row], index: int, lanes: Sequence[Lane]) -> tuple[Row | None, Row | None]:
    """The nearest cars in a lane that are worth mentioning: (ahead, behind)."""
    ego = rows[0]
    there = [row for row in rows[1:] if _lane(row, lanes) == index]
    ahead = min((r for r in there if 0.0 <= r[X] - ego[X] < SEEN_AHEAD_M), key=lambda r: r[X], default=None)
    behind = max((r for r in there if 0.0 < ego[X] - r[X] < SEEN_BEHIND_M), key=lambda r: r[X], default=None)
    return ahead, behind


def _beside(rows: list[Row], lanes: Sequence[Lane], own: int, index: int) -> str:
    """The lane `index` as somewhere to go from the lane `own`."""
    ego = rows[0]
    if not _exists(lanes, index, ego[X]) or lanes[index].kind == "ramp":
        return "none"
    if ego[X] < lanes[own].change_from_m:
        return "not yet"
    cars = [_car(ego, row) for row in _neighbours(rows, index, lanes) if row]
    return "; ".join(cars) if cars else "oncoming lane, clear" if lanes[index].direction < 0 else "clear"


def _car(ego: Row, other: Row) -> str:
    gap, faster = _gap(ego, other), other[VX] - ego[VX]
    where = "beside" if gap <= 0.0 else f"{gap:.0f} {'ahead' if other[X] > ego[X] else 'behind'}"
    if other[VX] < -SAME_SPEED_MPS:
        return f"{where}, oncoming"
    if abs(faster) <= SAME_SPEED_MPS:
        return f"{where}, same speed"
    return f"{where}, {abs(faster):.0f} {'faster' if faster > 0 else 'slower'}"
