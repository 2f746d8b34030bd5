"""What the language model may answer: a few flat slots, validated before anything is made of them."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from schemas.wire.text import plain

Outcome = Literal["directive", "refused", "out_of_scope", "unclear"]
Speed = Literal["faster", "slower", "keep", "stop", "none"]
LaneSlot = Literal["left", "right", "leftmost", "rightmost", "keep", "none"]
Gap = Literal["closer", "farther", "keep", "none"]

MAX_REASONING_CHARS, MAX_WORDS_CHARS = 80, 300
FAR_OVER_LIMIT = 1.5
"""A named speed up to this multiple of the limit is clamped to the limit; a higher one is refused."""
NO_DECISION = {"reasoning", "say", "language"}
"""Fields that change nothing about what the car does."""


Words = Annotated[str, AfterValidator(lambda text: plain(text, MAX_WORDS_CHARS))]
"""A model's, which people will see: on one line, and cut off where it is too long."""


class Slots(BaseModel):
    """The passenger's wish in slots: the structured part of the model's text R_t (Eq. 8), before Parse (Eq. 9).

    Every slot but the outcome has a default, so that a small model need only write what was asked for.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    reasoning: Words = ""
    outcome: Outcome
    speed: Speed = "none"
    target_speed_mps: float | None = Field(default=None, ge=0, le=1000, allow_inf_nan=False)
    lane: LaneSlot = "none"
    gap: Gap = "none"
    headway_s: float | None = Field(default=None, ge=0, le=60, allow_inf_nan=False)
    overtake: bool | None = None
    cancel: bool = False
    say: Words = ""
    language: str = Field(default="en", exclude=True)
    """Of the passenger's sentence, for our reply; told by the intent parser, never by the model."""
    miles: bool = Field(default=False, exclude=True)
    """The passenger speaks of miles."""
    to_lane: int | None = Field(default=None, exclude=True)
    """The lane's index where it is more than one over; -1 or the number of lanes: there is no such lane."""

    def decision(self) -> dict[str, object]:
        """The slots that decide what the car does, for comparing two answers."""
        if self.outcome != "directive":
            return {"outcome": self.outcome}
        return self.model_dump(exclude=NO_DECISION)

    def is_empty(self) -> bool:
        """A directive that asks for nothing at all."""
        return self.decision() == Slots(outcome="directive").decision()

    def labelled(self, limit_mps: float) -> dict[str, object]:
        """As the labelled sets have it: "none" as null, and a speed [m/s] over the limit clamped to it."""
        asked = self.model_dump(include={"speed", "target_speed_mps", "lane", "gap", "headway_s", "overtake", "cancel"})
        if self.target_speed_mps is not None:
            asked["target_speed_mps"] = round(min(self.target_speed_mps, limit_mps), 2)
        if self.headway_s is not None:
            asked["headway_s"] = round(self.headway_s, 2)
        return {slot: None if value == "none" else value for slot, value in asked.items()}

    def compact(self) -> str:
        """JSON of the slots that differ from their defaults: the shortest answer worth imitating."""
        return json.dumps(self.model_dump(exclude_defaults=True), ensure_ascii=False, separators=(",", ":"))


ANSWERED = frozenset(Slots.model_fields) - {"language", "to_lane"}
"""What is read of a model's answer."""


def adapted_schema() -> dict[str, Any]:
    """JSON schema of what the embedded model's adapter has learnt to answer: only what was asked for, no numbers."""
    properties: dict[str, Any] = {
        "outcome": {"type": "string", "enum": ["directive", "refused", "out_of_scope", "unclear"]},
        "speed": {"type": "string", "enum": ["faster", "slower", "keep", "stop"]},
        "lane": {"type": "string", "enum": ["left", "right", "leftmost", "rightmost", "keep"]},
        "gap": {"type": "string", "enum": ["closer", "farther", "keep"]},
        "overtake": {"type": "boolean"},
        "cancel": {"type": "boolean"},
    }
    return {"type": "object", "properties": properties, "required": ["outcome"], "additionalProperties": False}


def answer_schema(short: bool) -> dict[str, Any]:
    """JSON schema of an answer. Short: unasked slots may be left out. Else all are required, as strict servers want."""
    properties: dict[str, Any] = {
        "reasoning": {"type": "string"},
        "outcome": {"type": "string", "enum": ["directive", "refused", "out_of_scope", "unclear"]},
        "speed": {"type": "string", "enum": ["faster", "slower", "keep", "stop", "none"]},
        "target_speed_mps": {"type": ["number", "null"]},
        "lane": {"type": "string", "enum": ["left", "right", "leftmost", "rightmost", "keep", "none"]},
        "gap": {"type": "string", "enum": ["closer", "farther", "keep", "none"]},
        "headway_s": {"type": ["number", "null"]},
        "overtake": {"type": ["boolean", "null"]},
        "cancel": {"type": "boolean"},
        "say": {"type": "string"},
    }
    if short:
        properties["reasoning"] = {"type": "string", "maxLength": MAX_REASONING_CHARS}
        del properties["say"]  # the small model's sentences are not worth the second they take; ours are
    required = ["reasoning", "outcome"] if short else list(properties)
    return {"type": "object", "properties": properties, "required": required, "additionalProperties": False}
