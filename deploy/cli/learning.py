"""`fastslow train` and `study`: policies learn, and are compared."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from deploy.cli.bounded import Commands
from deploy.cli.options import EXITS, Json, Ray, readable_ends
from deploy.cli.settings import read_config, settings

commands = Commands()


@commands.command(
    epilog="Examples:\n\n  fastslow train\n\n"
    "  fastslow train --scenario highway --steps 20000 --seed 1 --out mine.safetensors\n\n"
    "  fastslow train --start mine.safetensors --learning-rate 1e-4 --scenario merge\n\n"
    "  fastslow train --algorithm taught --scenario merge --scenario exit --steps 48000\n\n"
    "  fastslow train --algorithm ppo --bare --out runs/ppo-bare.safetensors\n\n"
    "  fastslow train --algorithm maskable-ppo --set n_steps=64 --set learning_rate=3e-4\n\n"
    "  fastslow train --algorithm ppo --seed 3 --ray auto\n\n"
    "  fastslow train --config mine.toml --set entropy=0.02 --track\n\n" + EXITS
)
def train(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="Where the policy goes, with a JSON sidecar beside it.")] = Path(
        "runs/policy.safetensors"
    ),
    scenario: Annotated[
        list[str] | None,
        typer.Option(help="Roads to learn on; may be repeated.", show_default="highway, merge, two-way"),
    ] = None,
    steps: Annotated[int, typer.Option(min=1024, help="Decisions to learn from (the paper's budget by default).")] = (
        100_000
    ),
    seed: Annotated[int, typer.Option(min=0, help="Of the network, the traffic and the directives.")] = 0,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on where an interrupted run to --out was last saved, in new traffic.")
    ] = False,
    start: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Begin with the network of another run's policy, beside which its .train.pt lies.",
            show_default="a random one",
        ),
    ] = None,
    learning_rate: Annotated[
        float | None, typer.Option(help="At the start; it falls to a tenth.", show_default="0.0005")
    ] = None,
    mask_preset: Annotated[
        str, typer.Option(help="What the mask assumes of others, in training and in driving: sim or cautious.")
    ] = "sim",
    algorithm: Annotated[
        str,
        typer.Option(
            help="ours; taught, by a teacher that tries things out (--steps: situations in all); or a baseline for "
            "comparison: ppo, dqn, a2c or maskable-ppo. --resume, --start, --learning-rate and --mask-preset are for "
            "ours alone."
        ),
    ] = "ours",
    bare: Annotated[bool, typer.Option("--bare", help="A baseline as published: no mask, no directive.")] = False,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml",
            help="Options of this command by name, and a table [learner] of what --set sets; the command line wins.",
            callback=read_config,
            is_eager=True,
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="A hyper-parameter of the learner, such as gamma, entropy, minibatch or scenes; may be repeated. "
            "Another name is refused, with those that there are.",
        ),
    ] = None,
    track: Annotated[
        bool,
        typer.Option("--track", help="Keep a W&B run beside the policy, offline unless WANDB_MODE says otherwise."),
    ] = False,
    ray: Ray = None,
) -> None:
    """Learn one policy for the given roads (some minutes on one core)."""
    changes = settings(context, set_ or [])
    roads = scenario or ["highway", "merge", "two-way"]
    if algorithm in ("ours", "taught") and bare:
        raise typer.BadParameter("only a baseline: choose one by --algorithm", param_hint="'--bare'")
    ours_only = {
        "--resume": resume,
        "--start": start is not None,
        "--learning-rate": learning_rate is not None,
        "--mask-preset": mask_preset != "sim",
    }
    if algorithm != "ours" and (given := [option for option, chosen in ours_only.items() if chosen]):
        raise typer.BadParameter("for algorithm ours alone", param_hint=f"'{given[0]}'")
    if resume and start is not None:
        raise typer.BadParameter("a resumed run has begun already: leave one out", param_hint="'--start'")
    if ray is not None and (resume or start is not None):
        raise typer.BadParameter("--resume and --start go on from files that lie here", param_hint="'--ray'")
    if learning_rate is not None and "lr" in changes:
        raise typer.BadParameter("it is --learning-rate: give it once", param_hint="'--set lr'")
    if algorithm == "taught" and (changes or track):
        raise typer.BadParameter("for learners by reward alone", param_hint="'--set'" if changes else "'--track'")
    with readable_ends():
        from deploy.lab.farm import Farm
        from deploy.lab.learning import Training, run_on

        training = Training(
            algorithm=algorithm,
            scenarios=tuple(roads),
            steps=steps,
            seed=seed,
            changes=changes,
            bare=bare,
            ours={"lr": learning_rate, "resume": resume, "start": start, "preset": mask_preset},
            track=track,
        )
        figures = training.run(out) if ray is None else run_on(Farm(ray=ray), training, out)
    told = [
        f"{name.replace('_', ' ')} {figures[name]:.3g}"
        for name in ("episodic_return", "crash_rate", "loss")
        if not math.isnan(figures.get(name, math.nan))
    ]
    typer.echo(f"{out}{': ' if told else ''}{', '.join(told)}", err=True)


@commands.command(
    epilog="Examples:\n\n  fastslow study\n\n  fastslow study --quick --json\n\n"
    "  fastslow study --tune --out runs/search\n\n  fastslow study --mind --out runs/mind\n\n" + EXITS
)
def study(
    out: Annotated[
        Path, typer.Option(help="Where cells, study.json, .csv and .png go; finished cells are kept.")
    ] = Path("runs/study"),
    algorithm: Annotated[
        list[str] | None, typer.Option(help="ours, ppo, dqn, a2c or maskable-ppo; may be repeated.", show_default="all")
    ] = None,
    variant: Annotated[
        list[str] | None,
        typer.Option(
            help="Of the baselines: bare, masked (mask and directive), mask-only or wish-only; may be repeated.",
            show_default="bare, masked",
        ),
    ] = None,
    scenario: Annotated[
        list[str] | None, typer.Option(help="Roads; may be repeated.", show_default="highway, merge, two-way")
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            min=1, help="How many, from 0; with --tune from 100.", show_default="5; with --tune 1, with --memory 12"
        ),
    ] = None,
    steps: Annotated[int, typer.Option(min=256, help="Decisions per run.")] = 100_000,
    jobs: Annotated[int, typer.Option(min=1, help="Runs side by side.")] = 2,
    ray: Ray = None,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="Our learner only, 10,000 decisions, never resumed, in --out/quick; exit code 1 if it learns too "
            "little.",
        ),
    ] = False,
    tune: Annotated[
        bool, typer.Option("--tune", help="Try other settings of the baselines instead, on seeds of their own.")
    ] = False,
    mind: Annotated[
        bool,
        typer.Option(
            "--mind",
            help="Drive with directives from reader, embedded model, both, an endpoint (if set) and none, at added "
            "delays, with model, scene and memory switched off in turn; --quick: a few of them.",
        ),
    ] = False,
    memory: Annotated[
        bool, typer.Option("--memory", help="What remembering changes in driving instead: --seeds drives of each kind.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Compare our learner with PPO, DQN, A2C and MaskablePPO over several seeds; run again to go on."""
    with readable_ends():
        from deploy.lab.farm import Farm
        from deploy.lab.study.cells import ALGORITHMS, ROADS
        from deploy.lab.study.matrix import run_search, run_study
        from fast_node.policies.mlp import BASELINES, VARIANTS

        if mind:
            from deploy.lab.study.mind import SEEDS, run_mind_study

            if tune or algorithm or variant or scenario:
                raise ValueError("--mind takes --out, --seeds, --quick and --json: leave the others out")
            raise typer.Exit(run_mind_study(out, seeds=seeds or SEEDS, quick=quick, as_json=as_json))
        if memory:
            from deploy.lab.study.memory import run_memory

            raise typer.Exit(run_memory(seeds or 12, scenario, as_json=as_json))
        if tune and quick:
            raise ValueError("--tune and --quick are two things: leave one out")
        if tune:
            code = run_search(
                out,
                algorithms=algorithm or BASELINES,
                variants=variant or VARIANTS,
                scenarios=scenario or ROADS,
                seeds=seeds or 1,
                steps=steps,
                farm=Farm(jobs, ray),
                as_json=as_json,
            )
        else:
            code = run_study(
                out,
                algorithms=algorithm or ALGORITHMS,
                variants=variant or VARIANTS,
                scenarios=scenario or ROADS,
                seeds=range(seeds or 5),
                steps=steps,
                farm=Farm(jobs, ray),
                quick=quick,
                as_json=as_json,
            )
    raise typer.Exit(code)
