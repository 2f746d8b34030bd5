"""What came of a duty, and the table of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

SCHEMA = "fastslow.conform/1"


@dataclass(frozen=True)
class Duty:
    """One duty of `schemas/README.md`."""

    name: str
    asks: str
    """What it asks for."""
    holds: bool
    found: str
    """What was measured, or what is wrong and how to mend it."""


def budget_text(budget_ns: int) -> str:
    """As a duty names it."""
    return f"{budget_ns / 1e6:g} ms"


def all_hold(duties: Sequence[Duty]) -> bool:
    return bool(duties) and all(duty.holds for duty in duties)


def table(duties: Sequence[Duty]) -> str:
    """A line per duty."""
    wide = max(len(duty.name) for duty in duties)
    lines = [f"{duty.name:<{wide}}  {'ok   ' if duty.holds else 'WRONG'}  {duty.found}" for duty in duties]
    wrong = [duty for duty in duties if not duty.holds]
    lines += [f"  {duty.name}: the protocol asks: {duty.asks}" for duty in wrong]
    lines.append(f"{len(duties) - len(wrong)} of {len(duties)} duties hold")
    return "\n".join(lines)


def as_data(role: str, duties: Sequence[Duty]) -> dict[str, Any]:
    """The same for programs."""
    return {"schema": SCHEMA, "role": role, "conforms": all_hold(duties), "duties": [asdict(duty) for duty in duties]}
