"""`fastslow evaluate` and `interpret`: how well it drives, and how well it understands."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from deploy.cli.bounded import Commands
from deploy.cli.options import (
    EXITS,
    BaseUrl,
    BudgetS,
    Density,
    Dropout,
    Full,
    Json,
    MaxTokens,
    ModelName,
    NoiseM,
    NoiseMps,
    Ray,
    Sim,
    Traffic,
    names,
    readable_ends,
)

commands = Commands()


def pair_of(checkpoints: list[Path], *, alone: bool) -> list[str]:
    """The two that are to be compared, or none. alone: nobody else is to drive. Raises `typer.BadParameter`."""
    if len(checkpoints) > 2:
        raise typer.BadParameter("one, or two to compare", param_hint="'--checkpoint'")
    pair = [str(path) for path in checkpoints] if len(checkpoints) == 2 else []
    if pair and not alone:
        raise typer.BadParameter(
            "two are compared with each other: leave other drivers out", param_hint="'--checkpoint'"
        )
    if len(set(pair)) == 1:
        raise typer.BadParameter("the two are the same file", param_hint="'--checkpoint'")
    return pair


@commands.command(
    epilog="Examples:\n\n  fastslow evaluate\n\n  fastslow evaluate --all --episodes 300 --json\n\n"
    "  fastslow evaluate --agent rule --agent idm --scenario merge\n\n"
    "  fastslow evaluate --agent ours --policy mine:load --policy constant:faster\n\n"
    "  fastslow evaluate --checkpoint old.safetensors --checkpoint new.safetensors --rows episodes.csv\n\n"
    "  fastslow evaluate --scenario highway --density 2 --directive-at 10 --first-seed 5200\n\n"
    "  fastslow evaluate --all --episodes 300 --keep runs/roads.jsonl --jobs 2\n\n"
    "  fastslow evaluate --scenario highway --wish 23 --wish 25 --wish 28 --plot tradeoff.png\n\n"
    "  fastslow evaluate --sim sumo --scenario merge-natural --agent ours --agent sumo-eidm --episodes 300\n\n"
    "  fastslow evaluate --scenario merge --agent rule --episodes 20 --video films\n\n" + EXITS
)
def evaluate(
    agent: Annotated[
        list[str] | None,
        typer.Option(
            help="Who drives; may be repeated: see the table it prints. constant:best is chosen of 120 "
            "orders first; dilu-paused and dilu-running ask a language "
            "model every second: both take minutes.",
            show_default="whom --checkpoint was trained as, or ours",
        ),
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SPEC",
            help="Any policy that `run --policy` takes, behind the mask; may be repeated. Two alone are compared, "
            "paired by seed.",
            show_default="none",
        ),
    ] = None,
    scenario: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|FILE.toml",
            help="Where: a road's name, or a file that changes one; may be repeated.",
            show_default="highway, merge, two-way",
        ),
    ] = None,
    sim: Sim = "highway-env",
    density: Density = 1.0,
    traffic: Traffic = "",
    everything: Annotated[bool, typer.Option("--all", help="Every agent on every scenario.")] = False,
    checkpoint: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="A policy of ours or of a baseline, in the place of its agent's own; ours drives without the "
            "shipped plans. Two: compare them behind the mask, paired by seed.",
            show_default="the shipped ones",
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="How many, each with its own seed.")] = 100,
    first_seed: Annotated[int, typer.Option(min=0, help="Of the first episode; the others follow.")] = 1000,
    directive: Annotated[
        str,
        typer.Option(help="Asked for: full speed in any lane (hurry), in a drawn lane (lane), or any wish (random)."),
    ] = "hurry",
    directive_at: Annotated[
        float, typer.Option(min=0.0, metavar="SECONDS", help="When it is asked for; without words until then.")
    ] = 0.0,
    mask_preset: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="What the mask assumes of others.", show_default="what the policy was trained with"
        ),
    ] = None,
    wish: Annotated[
        list[float] | None,
        typer.Option(
            min=0.0,
            metavar="MPS",
            help="Wish for this speed instead; may be repeated, to drive with each.",
            show_default="as the directive has it",
        ),
    ] = None,
    noise_m: NoiseM = 0.0,
    noise_mps: NoiseMps = 0.0,
    dropout: Dropout = 0.0,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png",
            dir_okay=False,
            writable=True,
            help="Draw speed against comfort, a point per wish (two or more).",
        ),
    ] = None,
    rows: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", dir_okay=False, writable=True, help="Write a row per episode there."),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", dir_okay=False, writable=True, help="Write every figure of every row there."),
    ] = None,
    video: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            file_okay=False,
            writable=True,
            help="Film the first episode of every row there, and the one with the lowest ride score.",
        ),
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.jsonl",
            dir_okay=False,
            help="Keep what was driven there, and drive only what is missing: for evaluations that may be interrupted.",
        ),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Rows side by side, each in a process.", show_default="one by one")
    ] = None,
    ray: Ray = None,
    as_json: Json = False,
) -> None:
    """Drive episodes on seeds that training never saw, and print what came of it with 95 % intervals."""
    if plot is not None and len(set(wish or ())) < 2:
        raise typer.BadParameter("needs two or more wishes: --wish 20 --wish 25", param_hint="'--plot'")
    for option, file in (("--plot", plot), ("--rows", rows), ("--table", table), ("--keep", keep)):
        if file is not None and not file.parent.is_dir():
            raise typer.BadParameter(f"no folder {file.parent}: make it first", param_hint=f"'{option}'")
    checkpoints = checkpoint or []
    pair = pair_of(checkpoints, alone=not (agent or policy or everything))
    if not (pair or checkpoints or agent or everything) and len(set(policy or ())) == 2:
        pair = list(dict.fromkeys(policy or ()))
    with readable_ends():
        if plot is not None:
            import_module("matplotlib")  # a missing one is told before minutes of driving, not after
        if video is not None:
            import_module("imageio_ffmpeg")
        from deploy.lab import evaluate as lab
        from deploy.lab import report
        from deploy.lab.agents import AGENTS
        from deploy.lab.episodes import Directive
        from deploy.lab.farm import Farm
        from deploy.lab.files import write_table
        from deploy.lab.paired import Episode, compare, paired_table, write_rows
        from deploy.lab.rows import Kept
        from sim_node.scenarios import SCENARIOS

        def film(place: Mapping[str, Any], results: Any, again: Any) -> None:
            from deploy.film.evaluated import film_row

            assert video is not None
            for path in film_row(video, place, results, again):
                typer.echo(f"filmed {path}", err=True)

        each: list[Episode] = []
        result = lab.evaluate_all(
            list(AGENTS) if everything else agent or None,
            list(SCENARIOS) if everything else scenario or ["highway", "merge", "two-way"],
            episodes,
            policies=pair or policy or (),
            first_seed=first_seed,
            checkpoint=None if pair or not checkpoints else checkpoints[0],
            directive=cast(Directive, directive),
            directive_at_s=directive_at,
            mask_preset=mask_preset,
            density=density,
            traffic=names(traffic),
            wishes_mps=wish or [None],
            noise_m=noise_m,
            noise_mps=noise_mps,
            dropout=dropout,
            sim=sim,
            progress=lambda text: typer.echo(text, err=True),
            each=each,
            film=None if video is None else film,
            farm=Farm(jobs or 0, ray),
            kept=Kept(keep),
        )
        if rows is not None:
            write_rows(each, rows)
        if table is not None:
            write_table(result["rows"], table)
        if pair:
            result["paired"] = compare(each, *pair)
        typer.echo(json.dumps(result) if as_json else report.table(result))
        if pair and not as_json:
            typer.echo(paired_table(result["paired"]))
        if plot is not None:
            report.plot(result["rows"], plot)


@commands.command(
    epilog="Examples:\n\n  fastslow interpret --input commands.jsonl --output directives.jsonl\n\n"
    '  echo \'{"id": 1, "text": "a bit slower"}\' | fastslow interpret --input -\n\n'
    '  fastslow interpret --explain "a bit slower, please" --ask always\n\n'
    "  fastslow interpret --score --json\n\n  fastslow interpret --experiment memory --per-kind 5\n\n" + EXITS
)
def interpret(
    source: Annotated[
        str | None, typer.Option("--input", help='JSON lines {"id", "text", "scene"?}; "-": stdin.')
    ] = None,
    output: Annotated[str, typer.Option(help='Where the JSON lines go; "-": stdout.')] = "-",
    scene: Annotated[Path | None, typer.Option(help="The scene of lines without one.", show_default="4 lanes")] = None,
    explain: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Interpret this one instead, and show all that led to what is made of it."),
    ] = None,
    full: Full = False,
    score: Annotated[bool, typer.Option("--score", help="Interpret and score a set of our own instead.")] = False,
    which: Annotated[
        str,
        typer.Option(
            "--set",
            metavar="NAME|FILE",
            help="To score: dev, programs, dialogues, strangers, strangers-dialogues, strangers-3, "
            "strangers-3-dialogues, a file like these (FILE.jsonl); "
            "or an exam, which is not for choosing by: blind, strangers-2, strangers-2-dialogues, strangers-4, "
            "strangers-4-dialogues.",
        ),
    ] = "dev",
    experiment: Annotated[
        str | None,
        typer.Option(
            help="memory: the model with 0, 2, 4 recalled examples; mind: reader, model, both; chatter: within talk."
        ),
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="With --experiment chatter: only every so many-th command.")] = 1,
    half: Annotated[str, typer.Option(help="Of the talk: measure, or develop, which is for choosing by.")] = "measure",
    per_kind: Annotated[
        int | None, typer.Option(min=1, help="Only so many of each kind of the set, the same ones every time.")
    ] = None,
    ask: Annotated[str, typer.Option(help="Ask the language model: auto, always, unsure or never.")] = "auto",
    parser: Annotated[bool, typer.Option(help="Use the trained intent parser.")] = True,
    k: Annotated[int, typer.Option(min=0, max=8, help="Examples recalled for the model.")] = 4,
    threads: Annotated[int, typer.Option(min=1, help="Of the embedded model.")] = 1,
    model: ModelName = None,
    base_url: BaseUrl = None,
    budget_s: BudgetS = None,
    max_tokens: MaxTokens = None,
    as_json: Json = False,
) -> None:
    """Turn commands into directives in batch mode, by the code that drives; or score that."""
    import os
    from typing import get_args

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy loads: two threads are slower
    from deploy.lab.interpret import batch
    from deploy.lab.interpret_chatter import chatter_experiment
    from deploy.lab.interpret_exam import examine
    from deploy.lab.interpret_score import SETS, memory_experiment, score_set
    from deploy.lab.interpreter import Ask
    from deploy.run.processes import ModelOptions
    from slow_node.evaluation.chatter import Half
    from slow_node.evaluation.programs import EXAMS

    options = ModelOptions(name=model, base_url=base_url, budget_s=budget_s, max_tokens=max_tokens)
    if ask not in get_args(Ask):
        raise typer.BadParameter(f"{ask}: choose from {', '.join(get_args(Ask))}", param_hint="'--ask'")
    told: dict[str, Any] = {"ask": ask, "parser": parser, "k": k, "threads": threads, "model": options}
    if experiment is not None:
        if experiment == "memory":
            raise typer.Exit(memory_experiment(as_json=as_json, per_kind=per_kind, threads=threads))
        if experiment == "mind":
            from deploy.lab.interpret_mind import mind_experiment

            raise typer.Exit(mind_experiment(Path("runs/mind"), as_json=as_json, per_kind=per_kind, threads=threads))
        if experiment != "chatter":
            raise typer.BadParameter(f"{experiment}: choose from memory, mind, chatter", param_hint="'--experiment'")
        if half not in get_args(Half):
            raise typer.BadParameter(f"{half}: choose from {', '.join(get_args(Half))}", param_hint="'--half'")
        raise typer.Exit(chatter_experiment(cast(Half, half), as_json=as_json, per_kind=per_kind, every=every, **told))
    exam = which in EXAMS or which.endswith(".jsonl")
    if which not in SETS and not exam:
        raise typer.BadParameter(
            f"{which}: choose from {', '.join((*SETS, *EXAMS))}, or give a FILE.jsonl", param_hint="'--set'"
        )
    if score and exam:
        raise typer.Exit(examine(which, as_json=as_json, output=output, **told))
    if score:
        raise typer.Exit(score_set(which, as_json=as_json, per_kind=per_kind, output=output, **told))
    if explain is not None:
        from deploy.lab.explain import explain as show

        raise typer.Exit(show(explain, scene, as_json=as_json, full=full, **told))
    if source is None:
        raise typer.BadParameter('give a file or "-", or --explain or --score', param_hint="'--input'")
    raise typer.Exit(batch(source, output, scene, ask=ask, parser=parser, k=k, threads=threads, model=options))


@commands.command(
    epilog="Examples:\n\n  fastslow conform --sim -- python sim.py {port}\n\n"
    "  fastslow conform --driver -- python driver.py {port}\n\n"
    "  fastslow conform --driver --port 7447    (waits for a driver that connects by itself)\n\n" + EXITS
)
def conform(
    command: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[-- COMMAND...]",
            help="Starts the node; {port} is replaced by the port.",
            show_default="it connects by itself",
        ),
    ] = None,
    sim: Annotated[bool, typer.Option("--sim", help="Try a simulator.")] = False,
    driver: Annotated[bool, typer.Option("--driver", help="Try a driver.")] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="TCP port on 127.0.0.1 to listen on; 0: any.")] = 0,
    wait: Annotated[float, typer.Option(min=0.1, help="How long its first message may take, in seconds.")] = 20.0,
    budget_ms: Annotated[float, typer.Option(min=1.0, max=50.0, help="How long an answer may take.")] = 20.0,
    scenario: Annotated[str, typer.Option(help="The road that a driver is shown.")] = "two-way-natural",
    seed: Annotated[int, typer.Option(min=0, help="Of its traffic.")] = 0,
    as_json: Json = False,
) -> None:
    """Try somebody's simulator or driver on the bus, and print what is wrong with each of its duties."""
    from deploy.conform.run import conform as try_it

    if sim == driver:
        raise typer.BadParameter("choose one of them", param_hint="'--sim' / '--driver'")
    raise typer.Exit(
        try_it(
            "sim" if sim else "driver",
            command or (),
            port=port,
            wait_s=wait,
            budget_ms=budget_ms,
            scenario=scenario,
            seed=seed,
            as_json=as_json,
        )
    )
