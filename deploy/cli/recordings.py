"""`fastslow replay` and `export`: what a recorded run was, again and elsewhere."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from deploy.cli.bounded import Commands
from deploy.cli.options import EXITS, Json, readable_ends

commands = Commands()
File = Annotated[Path, typer.Argument(metavar="FILE", help="A recording, such as runs/.../recording.mcap.")]


@commands.command(
    epilog="Examples:\n\n  fastslow replay runs/20261127T120000Z-42/recording.mcap\n\n"
    "  fastslow replay x.mcap --check\n\n"
    "  fastslow replay x.mcap --policy rule\n\n  fastslow replay x.mcap --mask-preset cautious --json\n\n" + EXITS
)
def replay(
    file: File,
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="Feed the recorded inputs to the nodes again, and compare what they decide bit for bit; exit code 1 "
            "if anything differs.",
        ),
    ] = False,
    policy: Annotated[
        str | None,
        typer.Option(metavar="SPEC", help="Show where this one, as `run --policy` takes it, would decide otherwise."),
    ] = None,
    mask_preset: Annotated[
        str | None, typer.Option(help="Show where the mask, assuming this of others, would: sim or cautious.")
    ] = None,
    as_json: Json = False,
    speed: Annotated[float, typer.Option(min=0.1, max=8.0, help="Of the page's playback, at first.")] = 1.0,
    cockpit_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Where the page is served; if that is held, or 0: any free port.")
    ] = 8000,
) -> None:
    """Show a recording in the cockpit; or play it to the nodes again, and compare."""
    if check and (policy or mask_preset):
        raise typer.BadParameter(
            "compares with the recorded driver itself: leave the other out", param_hint="'--check'"
        )
    if not (check or policy or mask_preset):
        from deploy.cockpit.replay import replay as show

        raise typer.Exit(show(file, port=cockpit_port, speed=speed))
    with readable_ends():
        from deploy.replay.report import replay_check, replay_other

        code = (
            replay_check(file, as_json=as_json)
            if check
            else replay_other(file, policy=policy, mask_preset=mask_preset, as_json=as_json)
        )
    raise typer.Exit(code)


@commands.command(
    epilog="Examples:\n\n  fastslow export x.mcap --csv tables\n\n"
    "  fastslow export x.mcap --minari fastslow/highway-v0\n\n" + EXITS
)
def export(
    file: File,
    csv: Annotated[Path | None, typer.Option(metavar="DIR", help="Write CSV files, one per table, there.")] = None,
    parquet: Annotated[Path | None, typer.Option(metavar="DIR", help="The same tables as Parquet files.")] = None,
    minari: Annotated[
        str | None, typer.Option(metavar="NAME", help="Write a Minari data set of this name: an episode per world.")
    ] = None,
    finish: Annotated[
        bool,
        typer.Option(
            "--finish",
            help="Write the summary that a killed recorder could not: PlotJuggler wants one, we and Foxglove do not.",
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Turn a recording into tables or a data set."""
    if not (csv or parquet or minari or finish):
        raise typer.BadParameter("give one of these", param_hint="'--csv', '--parquet', '--minari' or '--finish'")
    with readable_ends():
        from deploy.record.export import to_csv, to_parquet
        from deploy.replay.report import complete, load

        recording = load(file)
        if finish:
            complete(recording)
        written: dict[str, object] = {"schema": "fastslow.export/1"}
        if csv is not None:
            written["csv"] = to_csv(recording, csv)
        if parquet is not None:
            written["parquet"] = to_parquet(recording, parquet)
        if minari is not None:
            from deploy.record.minari import to_minari

            written["minari"] = {"steps": to_minari(recording, minari)}
    if as_json:
        typer.echo(json.dumps(written))
        return
    for kind, target in (("csv", csv), ("parquet", parquet), ("minari", minari)):
        if target is not None:
            typer.echo(f"{target}: {written[kind]}")
