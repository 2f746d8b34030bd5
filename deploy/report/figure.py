"""What a figure of the report is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Table:
    """Numbers beside a figure."""

    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]


@dataclass(frozen=True)
class Figure:
    """One figure: plain text, and how it is drawn."""

    name: str
    """Of its files."""
    title: str
    caption: str
    draw: Callable[[Path], None]
    """Writes it, as PNG or SVG by the path's suffix."""
    findings: tuple[str, ...] = ()
    """What is seen in it, a sentence each."""
    table: Table | None = None


@dataclass
class Report:
    """What a report has, and what it lacks and why."""

    inputs: list[tuple[str, str]] = field(default_factory=list)
    """(file, what it is)."""
    figures: list[Figure] = field(default_factory=list)
    left_out: list[tuple[str, str]] = field(default_factory=list)
    """(figure, why)."""
