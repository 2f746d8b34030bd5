"""`fastslow video`: a drive as a film."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from deploy.cli.options import EXITS, Density, Traffic, names, readable_ends

commands = typer.Typer()


@commands.command(
    epilog="Examples:\n\n  fastslow video -o drive.gif\n\n"
    "  fastslow video --scenario merge --seed 1006 --say '' -o merge.mp4\n\n"
    '  fastslow video --scenario highway --policy rule --say "I\'m in a hurry" --say-at 5 -o hurry.webp\n\n' + EXITS
)
def video(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="A .gif, .webp or .mp4.")],
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
    """Drive one episode in lock-step and film it, in real time. Words are understood offline."""
    from deploy.film.drive import Words, pictures
    from deploy.film.writer import checked, write_film
    from deploy.run.processes import road_of
    from fast_node.mask import PRESETS
    from fast_node.policies.load import load_policy
    from schemas.runtime.process import ConfigError
    from sim_node.config import SimConfig

    with readable_ends():
        checked(output)
        if mask_preset is not None and mask_preset not in PRESETS:
            raise ConfigError(f"--mask-preset {mask_preset!r}: choose from {', '.join(PRESETS)}")
        config = SimConfig(**road_of(scenario), seed=seed, density=density, traffic=names(traffic))
        words = Words(say, say_at) if say else None
        drawn = pictures(config, load_policy(policy), words, duration, mask_preset)
        with typer.progressbar(drawn, length=round(duration * config.hz), label="filming", file=sys.stderr) as shown:
            count = write_film(output, shown)
        size_mb = output.stat().st_size / 1e6
        typer.echo(f"{output}: {count / config.hz:.1f} s of {scenario}, seed {seed}, {size_mb:.1f} MB")
