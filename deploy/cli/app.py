"""The command line, `fastslow`. Everything heavy is imported inside the commands: `--help` must be quick."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Annotated, cast

import typer

from deploy.cli.bench import app as bench
from deploy.lab.memory import app as memory

_PORT = 7447
_EXITS = (
    "Exit codes: 0 ok, 1 failed, 2 usage, 69 nobody there, 75 try again (port taken), "
    "78 bad configuration or model, 130/143 signals."
)

app = typer.Typer(
    name="fastslow",
    help="A car that drives fast, thinks slowly and listens to its passenger.",
    epilog="Examples:\n\n  fastslow run\n\n"
    '  fastslow say "I\'m in a hurry to get to work, I want to drive faster"\n\n' + _EXITS,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.add_typer(bench)
app.add_typer(memory)

Port = Annotated[int, typer.Option(min=1, max=65535, help="TCP port on 127.0.0.1 where the system listens.")]
Json = Annotated[bool, typer.Option("--json", help="Data as JSON on stdout; everything else on stderr.")]


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"fastslow {version('fastslow')}")
        except PackageNotFoundError:
            print("fastslow (not installed: run from its source folder)")
        raise typer.Exit


@contextmanager
def _readable_ends() -> Iterator[None]:
    """What ends learning or evaluation early is one line and an exit code."""
    from schemas.runtime.process import CONFIG, ConfigError, Stopped, stop_on_signals

    try:
        with stop_on_signals():
            yield
    except Stopped as stopped:
        raise typer.Exit(stopped.code) from None
    except ImportError as error:
        extra = "baselines" if error.name == "stable_baselines3" else "train"
        typer.echo(f"fastslow: {error.name} is missing: pip install 'fastslow[{extra}]'", err=True)
        raise typer.Exit(CONFIG) from None
    except ConfigError as error:
        typer.echo(f"fastslow: {error}", err=True)
        raise typer.Exit(CONFIG) from None
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


@app.callback()
def _root(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    pass


@app.command(
    epilog="Examples:\n\n  fastslow run\n\n"
    '  fastslow run --duration 40 --say "I\'m in a hurry" --say-at 3 --json\n\n'
    "  fastslow run --without fast        (to bring your own)\n\n"
    "With OPENAI_API_KEY (and OPENAI_BASE_URL, OPENAI_MODEL) set, that model is asked instead of "
    "the embedded one.\n\n" + _EXITS
)
def run(
    scenario: Annotated[
        str,
        typer.Option(
            help="What road to drive on: highway, merge, two-way, merge-main, roadworks; highway-, merge- or "
            "two-way-natural."
        ),
    ] = "two-way",
    seed: Annotated[int, typer.Option(min=0, help="Which traffic there is on it.")] = 0,
    density: Annotated[float, typer.Option(min=0.2, max=3.0, help="Times the usual density of traffic.")] = 1.0,
    noise_m: Annotated[float, typer.Option(min=0.0, help="Error of perceived positions, standard deviation.")] = 0.0,
    noise_mps: Annotated[float, typer.Option(min=0.0, help="Error of perceived speeds, standard deviation.")] = 0.0,
    dropout: Annotated[float, typer.Option(min=0.0, max=0.9, help="Chance that a car goes unseen at a tick.")] = 0.0,
    duration: Annotated[
        float | None, typer.Option(min=1.0, help="End after this many seconds.", show_default="until Ctrl-C")
    ] = None,
    say: Annotated[str | None, typer.Option(metavar="TEXT", help="Say this to the car.")] = None,
    say_at: Annotated[float, typer.Option(min=0.0, help="When to say it, in seconds.")] = 3.0,
    port: Annotated[int, typer.Option(min=0, max=65535, help="TCP port on 127.0.0.1 to listen on; 0: any.")] = _PORT,
    as_json: Json = False,
    without: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Leave out sim, fast, slow or llm; may be repeated.")
    ] = None,
    realtime: Annotated[
        str,
        typer.Option(
            help="Scheduling of sim and fast: fifo (real-time, where permitted), user (what a plain user may), off, or "
            "auto: the best there is."
        ),
    ] = "auto",
    checkpoint: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The policy that drives.", show_default="the shipped one")
    ] = None,
) -> None:
    """Start the simulator, the fast and the slow node and the language model, and watch over them."""
    from deploy.run.processes import NAMES, RunOptions

    unknown = sorted(set(without or ()) - set(NAMES))
    if unknown:
        raise typer.BadParameter(f"{', '.join(unknown)}: choose from {', '.join(NAMES)}", param_hint="'--without'")
    from schemas.runtime.realtime import MODES

    if realtime not in MODES:
        raise typer.BadParameter(f"{realtime}: choose from {', '.join(MODES)}", param_hint="'--realtime'")
    from deploy.run.system import run_system

    raise typer.Exit(
        run_system(
            RunOptions(
                scenario=scenario,
                seed=seed,
                duration_s=duration,
                port=port,
                say=say,
                say_at_s=say_at,
                as_json=as_json,
                without=tuple(without or ()),
                realtime=realtime,
                checkpoint=checkpoint,
                density=density,
                noise_m=noise_m,
                noise_mps=noise_mps,
                dropout=dropout,
            )
        )
    )


@app.command(
    epilog='Examples:\n\n  fastslow say "I\'m in a hurry"\n\n'
    '  fastslow say --wait --json "please slow down a little"\n\n' + _EXITS
)
def say(
    text: Annotated[str, typer.Argument(help="What the passenger says.")],
    wait: Annotated[bool, typer.Option("--wait", help="Wait until it is fulfilled, expired or failed.")] = False,
    timeout: Annotated[
        float | None, typer.Option(min=0.1, help="Seconds to wait.", show_default="15; with --wait 90")
    ] = None,
    port: Port = _PORT,
    as_json: Json = False,
) -> None:
    """Say something to the car that is running, and hear its answer."""
    from deploy.run import passenger as talk

    timeout_s = timeout if timeout is not None else 90.0 if wait else 15.0
    raise typer.Exit(talk.say(text, port=port, wait=wait, timeout_s=timeout_s, as_json=as_json))


@app.command(epilog="Examples:\n\n  fastslow status\n\n  fastslow status --json\n\n" + _EXITS)
def status(port: Port = _PORT, as_json: Json = False) -> None:
    """Show the nodes of the running system and their figures."""
    from deploy.run import passenger as talk

    raise typer.Exit(talk.status(port=port, as_json=as_json))


@app.command(epilog="Examples:\n\n  fastslow doctor\n\n  fastslow doctor --json\n\n" + _EXITS)
def doctor(port: Port = _PORT, as_json: Json = False) -> None:
    """Check that everything a run needs is here, and say how to mend what is not."""
    from deploy.run.doctor import doctor as examine

    raise typer.Exit(examine(port=port, as_json=as_json))


@app.command(
    epilog="Examples:\n\n  fastslow train\n\n"
    "  fastslow train --scenario highway --steps 20000 --seed 1 --out mine.safetensors\n\n"
    "  fastslow train --start mine.safetensors --learning-rate 1e-4 --scenario merge\n\n"
    "  fastslow train --algorithm ppo --bare --out runs/ppo-bare.safetensors\n\n" + _EXITS
)
def train(
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
        float | None, typer.Option(min=0.0, help="At the start; it falls to a tenth.", show_default="0.0005")
    ] = None,
    mask_preset: Annotated[
        str, typer.Option(help="What the mask assumes of others, in training and in driving: sim or cautious.")
    ] = "sim",
    algorithm: Annotated[
        str,
        typer.Option(
            help="ours; or a baseline for comparison: ppo, dqn or a2c, for which --resume, --start, --learning-rate "
            "and --mask-preset are not."
        ),
    ] = "ours",
    bare: Annotated[bool, typer.Option("--bare", help="A baseline as published: no mask, no directive.")] = False,
) -> None:
    """Learn one policy for the given roads (some minutes on one core)."""
    roads = scenario or ["highway", "merge", "two-way"]
    if algorithm == "ours" and bare:
        raise typer.BadParameter("only a baseline: choose one by --algorithm", param_hint="'--bare'")
    ours_only = {
        "--resume": resume,
        "--start": start is not None,
        "--learning-rate": learning_rate is not None,
        "--mask-preset": mask_preset != "sim",
    }
    if algorithm != "ours" and (given := [option for option, chosen in ours_only.items() if chosen]):
        raise typer.BadParameter("not for a baseline", param_hint=f"'{given[0]}'")
    if resume and start is not None:
        raise typer.BadParameter("a resumed run has begun already: leave one out", param_hint="'--start'")
    with _readable_ends():
        from deploy.lab.training import train_baseline, train_policy

        figures = (
            train_policy(out, roads, steps, seed, lr=learning_rate, resume=resume, start=start, preset=mask_preset)
            if algorithm == "ours"
            else train_baseline(algorithm, out, roads, steps, seed, bare=bare)
        )
    told = [f"{name} {figures[name]:.3g}" for name in ("episodic_return", "crash_rate") if name in figures]
    typer.echo(": ".join((str(out), *told)), err=True)


@app.command(
    epilog="Examples:\n\n  fastslow study\n\n  fastslow study --quick --json\n\n"
    "  fastslow study --tune --out runs/search\n\n" + _EXITS
)
def study(
    out: Annotated[
        Path, typer.Option(help="Where cells, study.json and study.png go; finished cells are kept.")
    ] = Path("runs/study"),
    algorithm: Annotated[
        list[str] | None, typer.Option(help="ours, ppo, dqn or a2c; may be repeated.", show_default="all")
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
        int | None, typer.Option(min=1, help="How many, from 0; with --tune from 100.", show_default="5; with --tune 1")
    ] = None,
    steps: Annotated[int, typer.Option(min=256, help="Decisions per run.")] = 100_000,
    jobs: Annotated[int, typer.Option(min=1, help="Runs side by side.")] = 2,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="Our learner only, 10,000 decisions, always anew, in --out/quick; exit code 1 if it learns too "
            "little.",
        ),
    ] = False,
    tune: Annotated[
        bool, typer.Option("--tune", help="Try other settings of the baselines instead, on seeds of their own.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Compare our learner with PPO, DQN and A2C over several seeds; run again to go on."""
    with _readable_ends():
        from deploy.lab.study import ALGORITHMS, ROADS, run_search, run_study
        from fast_node.policies.mlp import BASELINES, VARIANTS

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
                jobs=jobs,
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
                jobs=jobs,
                quick=quick,
                as_json=as_json,
            )
    raise typer.Exit(code)


@app.command(
    epilog="Examples:\n\n  fastslow evaluate\n\n  fastslow evaluate --all --episodes 300 --json\n\n"
    "  fastslow evaluate --agent rule --agent idm --scenario merge\n\n"
    "  fastslow evaluate --scenario highway --wish 23 --wish 25 --wish 28 --plot tradeoff.png\n\n" + _EXITS
)
def evaluate(
    agent: Annotated[
        list[str] | None,
        typer.Option(
            help="Who drives; may be repeated: see the table it prints. dilu-paused and dilu-running ask a language "
            "model every second: minutes per episode.",
            show_default="whom --checkpoint was trained as, or ours",
        ),
    ] = None,
    scenario: Annotated[
        list[str] | None, typer.Option(help="Where; may be repeated.", show_default="highway, merge, two-way")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Every agent on every scenario.")] = False,
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A policy of ours or of a baseline, in the place of its agent's own.",
            show_default="the shipped ones",
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="How many, each with its own seed.")] = 100,
    first_seed: Annotated[int, typer.Option(min=0, help="Of the first episode; the others follow.")] = 1000,
    directive: Annotated[
        str,
        typer.Option(help="Asked for: full speed in any lane (hurry), in a drawn lane (lane), or any wish (random)."),
    ] = "hurry",
    wish: Annotated[
        list[float] | None,
        typer.Option(
            min=0.0,
            metavar="MPS",
            help="Wish for this speed instead; may be repeated, to drive with each.",
            show_default="as the directive has it",
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png",
            dir_okay=False,
            writable=True,
            help="Draw speed against comfort, a point per wish (two or more).",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Drive episodes on seeds that training never saw, and print what came of it with 95 % intervals."""
    if plot is not None and len(set(wish or ())) < 2:
        raise typer.BadParameter("needs two or more wishes: --wish 20 --wish 25", param_hint="'--plot'")
    if plot is not None and not plot.parent.is_dir():
        raise typer.BadParameter(f"no folder {plot.parent}: make it first", param_hint="'--plot'")
    with _readable_ends():
        if plot is not None:
            import_module("matplotlib")  # a missing one is told before minutes of driving, not after
        from deploy.lab.evaluate import AGENTS, Directive, evaluate_all, table
        from deploy.lab.evaluate import plot as draw
        from sim_node.scenarios import SCENARIOS

        result = evaluate_all(
            list(AGENTS) if everything else agent or None,
            list(SCENARIOS) if everything else scenario or ["highway", "merge", "two-way"],
            episodes,
            first_seed=first_seed,
            checkpoint=checkpoint,
            directive=cast(Directive, directive),
            wishes_mps=wish or [None],
            progress=lambda text: typer.echo(text, err=True),
        )
        typer.echo(json.dumps(result) if as_json else table(result))
        if plot is not None:
            draw(result["rows"], plot)


@app.command(
    epilog="Examples:\n\n  fastslow interpret --input commands.jsonl --output directives.jsonl\n\n"
    '  echo \'{"id": 1, "text": "a bit slower"}\' | fastslow interpret --input -\n\n'
    "  fastslow interpret --score --json\n\n  fastslow interpret --experiment memory --per-kind 5\n\n" + _EXITS
)
def interpret(
    source: Annotated[
        str | None, typer.Option("--input", help='JSON lines {"id", "text", "scene"?}; "-": stdin.')
    ] = None,
    output: Annotated[str, typer.Option(help='Where the JSON lines go; "-": stdout.')] = "-",
    scene: Annotated[Path | None, typer.Option(help="The scene of lines without one.", show_default="4 lanes")] = None,
    score: Annotated[bool, typer.Option("--score", help="Interpret and score a set of our own instead.")] = False,
    which: Annotated[
        str, typer.Option("--set", help="To score: dev, or blind, which is an exam: not for choosing by.")
    ] = "dev",
    experiment: Annotated[str | None, typer.Option(help="memory: the model with 0, 2, 4 recalled examples.")] = None,
    per_kind: Annotated[
        int | None, typer.Option(min=1, help="Only so many of each kind of the set, the same ones every time.")
    ] = None,
    ask: Annotated[str, typer.Option(help="Ask the language model: auto, always, unsure or never.")] = "auto",
    reader: Annotated[bool, typer.Option(help="Use the trained reader.")] = True,
    k: Annotated[int, typer.Option(min=0, max=8, help="Examples recalled for the model.")] = 4,
    threads: Annotated[int, typer.Option(min=1, help="Of the embedded model.")] = 1,
    as_json: Json = False,
) -> None:
    """Turn commands into directives in batch mode, by the code that drives; or score that."""
    import os
    from typing import get_args

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy loads: two threads are slower
    from deploy.lab import interpret as task

    if ask not in get_args(task.Ask):
        raise typer.BadParameter(f"{ask}: choose from {', '.join(get_args(task.Ask))}", param_hint="'--ask'")
    if experiment is not None:
        if experiment != "memory":
            raise typer.BadParameter(f"{experiment}: there is only memory", param_hint="'--experiment'")
        raise typer.Exit(task.memory_experiment(as_json=as_json, per_kind=per_kind, threads=threads))
    if which not in task.SETS:
        raise typer.BadParameter(f"{which}: choose from {', '.join(task.SETS)}", param_hint="'--set'")
    if score:
        raise typer.Exit(
            task.score_set(
                which, as_json=as_json, per_kind=per_kind, output=output, ask=ask, reader=reader, k=k, threads=threads
            )
        )
    if source is None:
        raise typer.BadParameter('give a file or "-", or --score', param_hint="'--input'")
    raise typer.Exit(task.batch(source, output, scene, ask=ask, reader=reader, k=k, threads=threads))


def main() -> None:
    """The entry point. Ctrl-C in a short command is an exit code, not a traceback."""
    try:
        app()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
