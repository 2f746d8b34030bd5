"""What the slow node took into account, message by message: read as those in `messages.py` are."""

from __future__ import annotations

from msgspec import Struct

from schemas.wire.messages import Command, Event, Message, Verdict
from schemas.wire.program import Program


class Found(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What the passenger's command was found to mean: the language model's answer, checked."""

    slots: str
    """As JSON; "": none."""
    why: str
    model_answered: bool
    program: Program | None = None
    """None: what the slots say, at once."""
    provisional: bool = False
    """The quick reader's, while the language model is still thinking."""
    verdict: Verdict = ""
    lesson: str = ""
    """What experience on a road like this one says about it: "less", "gentler"; "": nothing."""


class Input(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One thing that the slow node took into account.

    Exactly one of a tick, an event, a command, what is no command, what a command was found to mean, and
    what is preferred.
    """

    now_ns: int
    """When it did."""
    epoch: int = -1
    tick: int = -1
    """Of an observation."""
    event: Event | None = None
    command: Command | None = None
    """With the id that it was given on arrival, where it came without one."""
    refused: str | None = None
    """Why a payload is no command."""
    found: Found | None = None
    id: int = -1
    """Of what was refused or found."""
    manner: tuple[str, ...] | None = None
    """The kinds of what the passenger prefers on every drive, as the memory had them at the start."""


class Journal(Message, frozen=True, kw_only=True, tag="journal"):
    """What the slow node took into account, in its order: with it, its directives and replies can be had again."""

    seq: int
    """From 0, without gaps, since its start."""
    inputs: tuple[Input, ...]
