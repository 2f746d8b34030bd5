"""`fastslow bench`: the commands. Heavy imports are inside them."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from deploy.cli.bounded import Commands

app = Commands(
    name="bench",
    help="Measure what the runtime costs, on this machine and on the real processes.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Json = Annotated[bool, typer.Option("--json", help="Data as JSON on stdout; everything else on stderr.")]
Realtime = Annotated[
    str, typer.Option(help="Scheduling of sim, fast and all they are compared with: auto, fifo, user or off.")
]


def _chosen(values: list[str] | None, allowed: tuple[str, ...], option: str) -> tuple[str, ...]:
    unknown = sorted(set(values or ()) - set(allowed))
    if unknown:
        raise typer.BadParameter(f"{', '.join(unknown)}: choose from {', '.join(allowed)}", param_hint=f"'{option}'")
    return tuple(v for v in allowed if v in values) if values else allowed


def _fail(reason: object) -> typer.Exit:
    typer.echo(f"fastslow: {reason}", err=True)
    return typer.Exit(78)


@contextmanager
def _readable_ends() -> Iterator[None]:
    """What ends a benchmark early is one line and an exit code; whatever it has started has ended by then."""
    from deploy.bench.progress import MeasurementError
    from schemas.runtime.bus import BusError
    from schemas.runtime.process import ConfigError, Stopped, stop_on_signals

    try:
        with stop_on_signals():
            yield
    except Stopped as stopped:
        typer.echo("fastslow: stopped", err=True)
        raise typer.Exit(stopped.code) from None
    except MeasurementError as lost:
        typer.echo(f"fastslow: {lost}", err=True)
        raise typer.Exit(1) from None
    except (ConfigError, BusError, OSError) as error:
        raise _fail(error) from None


def _matplotlib(plot: Path | None) -> None:
    if plot is not None and importlib.util.find_spec("matplotlib") is None:
        raise _fail("--plot needs matplotlib: pip install 'fastslow[bench]'")


@app.command(
    epilog="Examples:\n\n  fastslow bench latency\n\n"
    "  fastslow bench latency --seconds 20 --load none --peer floor --peer bus\n\n"
    "  fastslow bench latency --seconds 240 --json --plot latency.png\n\n"
    "  fastslow bench latency --seconds 900 --load llm --peer none\n\n"
    "  fastslow bench latency --load none --load watched --peer none    (what do cockpit and recorder cost?)\n\n"
    "Loads: none; cpu, a thread per core of matrix products; llm, the embedded language model "
    "answering without pause; watched, the recorder and the cockpit with a page. Several loads take turns in blocks "
    "of a minute, or of a quarter of --seconds, so that a machine that drifts does so for all of them. Peers that are "
    "not installed are absent: pip install 'fastslow[bench]'. What dies is absent too, with the reason; "
    "the exit code is 1 only if ours or the floor is."
)
def latency(
    seconds: Annotated[float, typer.Option(min=2.0, help="Paced time under each load; p99.9 needs 200.")] = 240.0,
    load: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LOAD", help="none, cpu, llm or watched; may be repeated.", show_default="the first three"
        ),
    ] = None,
    peer: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PEER",
            help="floor, bus, bus-default, zmq or dora; may be repeated. none: ours alone.",
            show_default="all that are installed",
        ),
    ] = None,
    realtime: Realtime = "auto",
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the paced distributions.")] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Where the result goes.", show_default="runs/bench-TIME-PID")
    ] = None,
    as_json: Json = False,
) -> None:
    """Time observation to action on the real processes, beside a floor, the bare bus and other transports."""
    from deploy.bench import latency as bench
    from deploy.bench import latency_report, latency_results
    from deploy.bench.loads import BY_ITSELF, LOADS
    from deploy.bench.transports import TRANSPORTS
    from schemas.runtime.realtime import MODES

    loads = _chosen(load or [*BY_ITSELF], LOADS, "--load")
    peers = () if peer == ["none"] else _chosen(peer, TRANSPORTS, "--peer")
    _chosen([realtime], MODES, "--realtime")
    _matplotlib(plot)
    with _readable_ends():
        result, path = bench.run(bench.Options(seconds=seconds, loads=loads, realtime=realtime, peers=peers, out=out))  # type: ignore[arg-type]
        if plot is not None and result["rows"]:
            latency_results.plot(result, plot)
    typer.echo(f"fastslow: kept in {path}", err=True)
    if as_json:
        typer.echo(json.dumps({k: v for k, v in result.items() if k != "histograms"}))
    else:
        for line in latency_report.lines(result):
            typer.echo(line)
    if any(row["what"] in ("ours", "floor") for row in result["absent"]):
        raise typer.Exit(1)


@app.command(
    epilog="Examples:\n\n  fastslow bench scale\n\n  fastslow bench scale --rounds 100 --json --plot scale.png"
)
def scale(
    rounds: Annotated[int, typer.Option(min=20, help="Round trips for each point.")] = 1000,
    seconds: Annotated[float, typer.Option(min=1.0, help="Of 15 Hz, for each number of simulators.")] = 20.0,
    realtime: Realtime = "auto",
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the curves.")] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Where the result goes.", show_default="runs/scale-TIME-PID")
    ] = None,
    as_json: Json = False,
) -> None:
    """Show how a tick's cost grows with vehicles, egos, simulators on one machine and message size, and what breaks."""
    from deploy.bench import scale as bench
    from schemas.runtime.realtime import MODES

    _chosen([realtime], MODES, "--realtime")
    _matplotlib(plot)
    with _readable_ends():
        result, path = bench.run(realtime, rounds, seconds, out)  # type: ignore[arg-type]
        if plot is not None:
            bench.plot(result, plot)
    typer.echo(f"fastslow: kept in {path}", err=True)
    if as_json:
        typer.echo(json.dumps(result))
    else:
        for line in bench.lines(result):
            typer.echo(line)
    if not all(curve["points"] for curve in result["curves"].values()):
        raise typer.Exit(1)


@app.command(epilog="Examples:\n\n  fastslow bench sim\n\n  fastslow bench sim --vehicles 50 --policy-hz 15 --json")
def sim(
    vehicles: Annotated[
        list[int] | None,
        typer.Option(min=1, help="Cars besides the ego, 20 or 50; may be repeated.", show_default="20 and 50"),
    ] = None,
    policy_hz: Annotated[
        list[int] | None,
        typer.Option(help="Decisions a second, a divisor of 15; may be repeated.", show_default="15, 5 and 1"),
    ] = None,
    variant: Annotated[
        list[str] | None,
        typer.Option(
            metavar="VARIANT",
            help="batched, accelerated, stock, envpool or training; may be repeated.",
            show_default="all that are installed",
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="CPU time of each variant in each setting.")] = 6.0,
    load: Annotated[str, typer.Option(help="Beside what: none, or llm (the embedded model without pause).")] = "none",
    as_json: Json = False,
) -> None:
    """Compare our simulator's engines with stock highway-env and EnvPool: ticks per CPU second, latency, parity."""
    from deploy.bench import sim as bench
    from schemas.runtime.process import ConfigError

    def progress(doing: str) -> None:
        typer.echo(f"fastslow: {doing}", err=True)

    try:
        result = bench.bench_sim(
            seconds=seconds,
            vehicles=vehicles or bench.VEHICLES,
            policy_hz=policy_hz or bench.POLICY_HZ,
            names=variant or None,
            load=load,
            progress=progress,
        )
    except ConfigError as error:
        raise _fail(error) from None
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    typer.echo(json.dumps(result) if as_json else bench.table(result))


@app.command(epilog="Examples:\n\n  fastslow bench gym\n\n  fastslow bench gym --envs 64 --decision-hz 1 --json")
def gym(
    envs: Annotated[int, typer.Option(min=1, max=1024, help="Environments at once.")] = 16,
    decision_hz: Annotated[int, typer.Option(help="Decisions a second, a divisor of 15.")] = 3,
    variant: Annotated[
        list[str] | None,
        typer.Option(
            metavar="VARIANT",
            help="vector, vector bare, sync, async, stock sync, stock async or parallel; may be repeated. The first is "
            "compared with the others.",
            show_default="all",
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Of all cores' time, for a variant's turn.")] = 2.0,
    turns: Annotated[int, typer.Option(min=1, help="Of each variant.")] = 5,
    as_json: Json = False,
) -> None:
    """Compare our vector environment with Gymnasium's sync and async ones, of ours and of stock highway-env."""
    from deploy.bench import gym as bench

    def progress(doing: str) -> None:
        typer.echo(f"fastslow: {doing}", err=True)

    try:
        result = bench.bench_gym(
            envs=envs, decision_hz=decision_hz, seconds=seconds, turns=turns, names=variant or None, progress=progress
        )
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    except ImportError as error:
        raise _fail(f"{error.name} is missing: pip install 'fastslow[train]', or choose by --variant") from None
    typer.echo(json.dumps(result) if as_json else bench.table(result))


@app.command(epilog="Example:\n\n  fastslow bench compare runs/before/latency.json runs/after/latency.json")
def compare(
    a: Annotated[Path, typer.Argument(help="A saved result.")],
    b: Annotated[Path, typer.Argument(help="Another one.")],
    as_json: Json = False,
) -> None:
    """Compare two saved results of `bench latency`: the ratio B / A of p50 and p99, with 95 % intervals.

    What makes the two incomparable is said first. Exit code 1: they have no row in common.
    """
    from deploy.bench import latency_results
    from schemas.runtime.process import ConfigError

    try:
        result = latency_results.compare(latency_results.read(a), latency_results.read(b))
    except ConfigError as error:
        raise _fail(error) from None
    if as_json:
        typer.echo(json.dumps({"schema": "fastslow.bench.compare/1", **result}))
    else:
        for line in latency_results.compared(result):
            typer.echo(line)
    if not result["rows"]:
        typer.echo(f"fastslow: {a} and {b} have no row in common", err=True)
        raise typer.Exit(1)


@app.command(
    epilog="Examples:\n\n  fastslow bench passenger\n\n  fastslow bench passenger --repeats 10 --json\n\n"
    "The embedded model is used even where OPENAI_API_KEY is set. Exit code 1: a command went "
    "otherwise."
)
def passenger(
    repeats: Annotated[int, typer.Option(min=1, help="How often the ten commands are said.")] = 1,
    spacing: Annotated[
        float,
        typer.Option(min=0.1, help="Seconds from one command to the next, or longer if it is not decided by then."),
    ] = 4.0,
    seed: Annotated[int, typer.Option(min=0, help="Which traffic there is.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Where the result goes.", show_default="runs/passenger-TIME-PID"),
    ] = None,
    as_json: Json = False,
) -> None:
    """Say ten commands to the running system: what became of them, how soon, and what it cost the fast loop."""
    import os
    from datetime import UTC, datetime

    from deploy.bench.passenger import lines, measure
    from schemas.runtime.process import ConfigError

    folder = out or Path("runs") / f"passenger-{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        result = measure(folder, repeats=repeats, spacing_s=spacing, seed=seed)
        (folder / "passenger.json").write_text(json.dumps(result) + "\n", encoding="utf-8")
    except (ConfigError, OSError) as error:
        raise _fail(error) from None
    typer.echo(f"fastslow: kept in {folder / 'passenger.json'}", err=True)
    typer.echo(json.dumps(result) if as_json else "\n".join(lines(result)))
    if result["as_expected"] < result["n"]:
        raise typer.Exit(1)
