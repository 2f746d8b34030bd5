"""Settings of a command by file and by name: `--config FILE` and `--set NAME=VALUE`."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

TABLE = "learner"
"""The table of such a file that says what `--set` says; everything above it is an option of the command."""
_KEPT = "fastslow.settings"


def read_config(context: typer.Context, path: Path | None) -> Path | None:
    """Callback of an eager `--config`: what the file says stands in for options that are not given.

    Raises BadParameter for a file that is none, and for a name that is no option of the command.
    """
    if path is None or context.resilient_parsing:
        return path
    from schemas.runtime.errors import ConfigError
    from schemas.runtime.files import read_text_bounded

    try:
        said = tomllib.loads(read_text_bounded(path))
    except ConfigError as error:
        raise typer.BadParameter(str(error)) from None
    except tomllib.TOMLDecodeError as error:
        raise typer.BadParameter(f"{path}: {error}") from None
    context.meta[_KEPT] = said.pop(TABLE, {})
    if not isinstance(context.meta[_KEPT], dict):
        raise typer.BadParameter(f"{path}: {TABLE} is to be a table, [{TABLE}]")
    options = {
        option.removeprefix("--").replace("-", "_"): parameter.name or ""
        for parameter in context.command.params
        for option in parameter.opts
    }
    known = sorted(set(options) - {"config", "set", "help"})
    if unknown := sorted({name.replace("-", "_") for name in said} - set(known)):
        raise typer.BadParameter(f"{path} has {unknown[0]!r}: choose from {', '.join(known)}; or a table [{TABLE}]")
    context.default_map = {options[name.replace("-", "_")]: value for name, value in said.items()}
    return path


def settings(context: typer.Context, given: Sequence[str]) -> dict[str, Any]:
    """What the file's table and then `--set` say. Raises BadParameter for what is not NAME=VALUE."""
    out = dict(context.meta.get(_KEPT, {}))
    for one in given:
        name, equals, value = one.partition("=")
        if not name or not equals:
            raise typer.BadParameter(f"{one!r} is not NAME=VALUE", param_hint="'--set'")
        out[name.strip()] = _value(value.strip())
    return out


def _value(text: str) -> Any:
    """As TOML reads it, else the text itself; "none" is None."""
    if text.lower() == "none":
        return None
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
