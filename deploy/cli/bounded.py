"""Every number on the command line is finite and of a size that can be meant, whichever command takes it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import typer
from typer.core import TyperCommand

F = TypeVar("F", bound=Callable[..., Any])
MOST = 2**32 - 1
"""Of any number whose option names no smaller bound: seeds of 32 bits are in use."""


class BoundedCommand(TyperCommand):
    """A command that is not called with a number that is none, is without end, or is far too large.

    `min` and `max` of an option do not see a nan: it is neither below nor above anything.
    """

    def invoke(self, ctx: Any) -> Any:
        for param in self.params:
            value = ctx.params.get(param.name)
            for number in value if isinstance(value, (list, tuple)) else (value,):
                if isinstance(number, (int, float)) and not (math.isfinite(number) and abs(number) <= MOST):
                    raise typer.BadParameter(
                        f"{number} is not in the range -{MOST}..{MOST}.", param_hint=f"'{param.opts[0]}'"
                    )
        return super().invoke(ctx)


class Commands(typer.Typer):
    """Commands whose numbers are all bounded."""

    def command(self, name: str | None = None, **settings: Any) -> Callable[[F], F]:
        return super().command(name, cls=BoundedCommand, **settings)
