"""What came of a duty, and the table of all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

from schemas.wire.messages import SCHEMA_VERSION

SCHEMA = "fastslow.conform/1"
MAJOR = int(SCHEMA_VERSION.partition(".")[0])
NEWER, OTHER = f"{MAJOR}.99", f"{MAJOR + 1}.0"
"""A minor version that is to be read, and a major that is to be refused."""
READABLE = f"maps of protocol {MAJOR} with finite numbers within their bounds"
TOLERATED = 0.1
"""Share of ticks that may differ: the machine is shared, and messages may be dropped."""

J = TypeVar("J")


class Wrong(Exception):  # noqa: N818 - what a duty is that does not hold
    """A duty does not hold; `str()` says why."""


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


def judged(table: Iterable[tuple[str, str, J]], budget_ns: int, judge: Callable[[J], str]) -> list[Duty]:
    """A verdict per duty of a table of (name, what it asks for, by whom it is judged). judge: says what was found, or
    raises `Wrong`."""
    out = []
    for name, text, by in table:
        asks = text.format(budget=budget_text(budget_ns))
        try:
            out.append(Duty(name, asks, True, judge(by)))
        except Wrong as wrong:
            out.append(Duty(name, asks, False, str(wrong)))
    return out


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
