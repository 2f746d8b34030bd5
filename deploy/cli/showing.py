"""`fastslow video` and `report`: a drive as a film, and the figures of a paper."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from deploy.cli.bounded import Commands
from deploy.cli.options import EXITS, Density, Traffic, names, readable_ends

commands = Commands()


@commands.command(
    epilog="Examples:\n\n  fastslow video -o drive.gif\n\n"
    "  fastslow video runs/20261127T120000Z-42/recording.mcap -o run.mp4\n\n"
    "  fastslow video x.mcap --from 12 --to 20 -o pass.gif\n\n"
    "  fastslow video --scenario merge --seed 1006 --say '' -o merge.mp4\n\n"
    '  fastslow video --scenario highway --policy rule --say "I\'m in a hurry" --say-at 5 -o hurry.webp\n\n' + EXITS
)
def video(
    context: typer.Context,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="A .gif, .webp or .mp4.")],
    recording: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE.mcap]", help="A recorded run to film.", show_default="drive a new episode"),
    ] = None,
    from_s: Annotated[
        float,
        typer.Option("--from", min=0.0, metavar="S", help="Of a recording: the second to begin at, as replay counts."),
    ] = 0.0,
    to_s: Annotated[
        float | None,
        typer.Option("--to", min=0.0, metavar="S", help="Of a recording: the last second.", show_default="its end"),
    ] = None,
    scenario: Annotated[
        str, typer.Option(metavar="NAME|FILE.toml", help="Where: a road's name, or a file that changes one.")
    ] = "two-way",
    seed: Annotated[int, typer.Option(min=0, help="Of the traffic.")] = 1000,
    density: Density = 1.0,
    traffic: Traffic = "",
    duration: Annotated[float, typer.Option(min=0.1, help="Seconds of driving, at most.")] = 30.0,
    policy: Annotated[
        str, typer.Option(metavar="SPEC", help="Who drives, as in `fastslow run --policy`.")
    ] = "fastslow",
    mask_preset: Annotated[str | None, typer.Option(help="Of the mask.", show_default="the policy's own")] = None,
    say: Annotated[str, typer.Option(metavar="TEXT", help="What the passenger says; '' for nothing.")] = (
        "I'm in a hurry to get to work, I want to drive faster"
    ),
    say_at: Annotated[float, typer.Option(min=0.0, metavar="S", help="When.")] = 2.0,
) -> None:
    """Film a recorded run; or drive one episode in lock-step, words understood offline, and film that. In real time."""
    _one_or_the_other(context, recording is not None)
    from deploy.film.drive import Words, pictures
    from deploy.film.writer import checked, write_film
    from deploy.run.processes import road_of
    from fast_node.mask import PRESETS
    from fast_node.policies.load import load_policy
    from schemas.driving.road import HZ
    from schemas.runtime.process import ConfigError
    from sim_node.config import SimConfig

    with readable_ends():
        checked(output)
        if mask_preset is not None and mask_preset not in PRESETS:
            raise ConfigError(f"--mask-preset {mask_preset!r}: choose from {', '.join(PRESETS)}")
        if recording is not None:
            about = str(recording)
            drawn, length_s = _recorded(recording, from_s, math.inf if to_s is None else to_s)
        else:
            about, length_s = f"{scenario}, seed {seed}", duration
            config = SimConfig(**road_of(scenario), seed=seed, density=density, traffic=names(traffic))
            words = Words(say, say_at) if say else None
            drawn = pictures(config, load_policy(policy), words, duration, mask_preset)
        with typer.progressbar(drawn, length=round(length_s * HZ), label="filming", file=sys.stderr) as shown:
            count = write_film(output, shown)
        typer.echo(f"{output}: {count / HZ:.1f} s of {about}, {output.stat().st_size / 1e6:.1f} MB")


def _one_or_the_other(context: typer.Context, recorded: bool) -> None:
    """A recording has its own road, driver and words; only a recording has a part to choose."""
    of_recordings = {"from_s", "to_s"}
    for parameter in context.command.params:
        name = str(parameter.name)
        source = context.get_parameter_source(name)
        if name in ("output", "recording") or source is None or source.name != "COMMANDLINE":
            continue
        if recorded and name not in of_recordings:
            raise typer.BadParameter("a recording has its own: leave it out", param_hint=f"'{parameter.opts[0]}'")
        if not recorded and name in of_recordings:
            raise typer.BadParameter("is of a recording: name its file", param_hint=f"'{parameter.opts[0]}'")


def _recorded(path: Path, from_s: float, to_s: float) -> tuple[Iterator[Any], float]:
    """A recording's pictures, and about how many seconds of them."""
    from deploy.film.recorded import pictures
    from deploy.record.moments import length_s
    from deploy.replay.report import load
    from schemas.runtime.process import ConfigError

    recording = load(path)
    end_s = min(to_s, length_s(recording))
    if from_s > end_s:
        raise ConfigError(f"--from {from_s:g}: choose a time before {end_s:.1f} s")
    if not recording.finished:
        typer.echo(f"fastslow: {path} was cut off, or is still written: filming as far as it goes", err=True)
    return pictures(recording, from_s, to_s), end_s - from_s


@commands.command(
    epilog="Examples:\n\n  fastslow report runs/20261127T120000Z-42 -o report\n\n"
    "  fastslow evaluate --agent ours --agent rule --json > e.json && fastslow report e.json -o report\n\n"
    "  fastslow report x.mcap e.json runs/study/study.json --at 2 --at 5.5 -o report\n\n" + EXITS
)
def report(
    run: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN...",
            help="Recordings, what `evaluate` has written with --json or --rows, study.json, latency.json of `bench "
            "latency`; or folders that hold them.",
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", file_okay=False, help="A folder.")],
    at: Annotated[
        list[float] | None,
        typer.Option(
            min=0.0,
            metavar="S",
            help="Moments of a recording to show; may be repeated.",
            show_default="those of the paper's case study: 1, 3, 20, 23",
        ),
    ] = None,
) -> None:
    """Draw a paper's figures (success, reward, filmstrip, latency, attention): PNG, SVG, and a page with them all."""
    with readable_ends():
        from deploy.report.build import CASE_STUDY_S, PAGE, build

        made = build(run, output, sorted(set(at or CASE_STUDY_S)), lambda text: typer.echo(text, err=True))
        typer.echo(f"{output / PAGE}: {', '.join(figure.name for figure in made.figures)}")
        for what, why in made.left_out:
            typer.echo(f"left out: {what}: {why}")
