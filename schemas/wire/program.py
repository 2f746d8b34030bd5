"""What a command asks for, as a short script that is sent and recorded.

SI units. A field that is left out asks for nothing. Steps without `when` begin together with the one before them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

Act = Literal[
    "drive", "faster", "slower", "keep", "stop", "lane", "gap", "closer", "farther", "overtake", "yield", "smoother",
    "cancel", "more", "less", "again", "opposite", "back",
]  # fmt: skip
"""drive: at a speed that is named; gap: of a size that is named; keep: `object` "speed", "lane" or "gap"; yield: leave
room for somebody. The last five go by what was said before: more of it, less of it, once more, the other way round,
as it was before it."""
Side = Literal["left", "right", "leftmost", "rightmost", "either"]
Unit = Literal["mps", "s", "m", "times"]
Mode = Literal["to", "by", "at_least", "at_most", "factor"]
Polarity = Literal["do", "not"]
TriggerKind = Literal["time", "distance", "passed", "free", "clear", "speed", "done", "exit"]
Question = Literal["", "speed", "limit", "gap", "lane", "why_not_overtake", "why_slow", "waiting", "safe", "plan"]
Outcome = Literal["directive", "refused", "out_of_scope", "unclear"]

Word = Annotated[str, Meta(max_length=40)]
Amount = Annotated[float, Meta(ge=0.0, le=10_000.0)]
MAX_STEPS = 6


class Trigger(Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """What is waited for."""

    kind: TriggerKind
    """time: so many seconds; distance: so many metres; passed: `object` has passed us, or we it; free: room in the lane
    on `side`; clear: no oncoming car near; speed: `value` is reached; done: the step before is; exit: the road ends."""
    object: Word = ""
    side: Literal["left", "right"] | None = None
    value: Amount | None = None
    """Seconds, metres or metres per second, as the kind has it."""


class Step(Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """One thing to do."""

    act: Act
    object: Word = ""
    """Whom or what it is about: "truck", "cyclist", "limit", ...; of "faster" also "bit": without a number."""
    side: Side | None = None
    count: Annotated[int, Meta(ge=1, le=8)] | None = None
    """So many lanes to `side`; without a side the lane of this number, from the left, the first being 1."""
    value: Amount | None = None
    unit: Unit | None = None
    mode: Mode | None = None
    polarity: Polarity = "do"
    when: Trigger | None = None
    """It begins then; None: with the step before, or at once."""
    until: Trigger | None = None
    """It ends then; None: with the next wish."""


class Program(Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """A whole command."""

    outcome: Outcome
    """As of `slots`; a question is "out_of_scope" of what can be driven, and is answered all the same."""
    steps: Annotated[tuple[Step, ...], Meta(max_length=MAX_STEPS)] = ()
    question: Question = ""
    miles: bool = False
    """The passenger speaks of miles; else of kilometres and metres."""


def plain(one: Program | Step) -> dict[str, Any]:
    """As plain JSON values, without what is left out."""
    values: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(one))
    return values
