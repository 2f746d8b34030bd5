"""`fastslow thoughts`: how commands were understood."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deploy.cli.bounded import Commands
from deploy.cli.options import EXITS, Full, Json, readable_ends

commands = Commands()


@commands.command(
    epilog="Examples:\n\n  fastslow thoughts\n\n  fastslow thoughts runs/20261127T120000Z-42 --last 1 --full\n\n"
    "  fastslow thoughts runs/20261127T120000Z-42/recording.mcap --json\n\n"
    'One sentence, without a run: fastslow interpret --explain "a bit slower"\n\n' + EXITS
)
def thoughts(
    run: Annotated[
        Path | None,
        typer.Argument(
            metavar="[RUN|FILE]",
            help="A run's folder, its thoughts.jsonl, or its recording.",
            show_default="the newest run",
        ),
    ] = None,
    last: Annotated[int | None, typer.Option(min=1, metavar="N", help="Only the newest N.", show_default="all")] = None,
    full: Full = False,
    as_json: Json = False,
) -> None:
    """Print how each command of a run was understood, newest last: what was recalled, asked, answered and changed."""
    with readable_ends():
        import json

        import msgspec

        from deploy.record.thoughts import find, kept_in, worded

        file = find(run)
        kept = kept_in(file, last)
        if as_json:
            rows = [{"time": one.time, **msgspec.to_builtins(one.thought)} for one in kept]
            typer.echo(json.dumps({"schema": "fastslow.thoughts/1", "file": str(file), "thoughts": rows}))
            return
        for one in kept:
            typer.echo("\n".join(worded(one, full=full)) + "\n")
        typer.echo(f"fastslow: {len(kept)} thought{'' if len(kept) == 1 else 's'} in {file}", err=True)
