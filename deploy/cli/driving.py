"""`fastslow run`, `say`, `status` and `doctor`: a running car and its passenger."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.cli.bounded import Commands
from deploy.cli.options import (
    DEFAULT_PORT,
    EXITS,
    Authority,
    BaseUrl,
    BudgetS,
    CarName,
    Cert,
    CertKey,
    Connect,
    Density,
    Dropout,
    Json,
    MaxTokens,
    ModelName,
    NoiseM,
    NoiseMps,
    Port,
    Sim,
    Traffic,
    names,
    readable_ends,
    sayable,
)

if TYPE_CHECKING:
    from deploy.run.passenger import Reach
    from schemas.runtime.bus_settings import Tls

commands = Commands()


def _certificates(
    listen: str | None, cert: str | None, key: str | None, ca: str | None, name: str | None
) -> Tls | None:
    """Those of a run, once they and where it listens are found to be good."""
    from deploy.run.certificates import certificates
    from deploy.run.links import car_name, endpoint
    from schemas.runtime.errors import ConfigError

    with readable_ends():
        car_name(name or "")
        tls = certificates(cert, key, ca, listens=True)
        if listen:
            endpoint(listen, tls, "--listen")
        elif tls is not None:
            raise ConfigError("--cert needs --listen tls/0.0.0.0:7447")
    return tls


def _car(port: int, connect: str | None, cert: str | None, key: str | None, ca: str | None, name: str | None) -> Reach:
    """The car that is meant."""
    from deploy.run.passenger import reach

    with readable_ends():
        return reach(port, connect, cert, key, ca, name)


@commands.command(
    epilog="Examples:\n\n  fastslow run\n\n"
    '  fastslow run --duration 40 --say "I\'m in a hurry" --say-at 3 --json\n\n'
    "  fastslow run --scenario highway --density 2 --traffic trucks,sway\n\n"
    "  fastslow run --sim sumo --scenario merge-natural\n\n"
    "  fastslow run --policy mine:load    (your own policy: a callable load in mine.py that returns it)\n\n"
    "  fastslow run --without fast        (to bring your own node)\n\n"
    "  fastslow run --base-url localhost:11434 --model qwen3:8b --budget-s 30    (Ollama)\n\n"
    "With OPENAI_API_KEY, OPENAI_BASE_URL or OLLAMA_HOST set, or with --base-url, that endpoint is asked "
    "instead of the embedded model.\n\n" + EXITS
)
def run(
    scenario: Annotated[
        str, typer.Option(metavar="NAME|FILE.toml", help="Where: a road's name, or a file that changes one.")
    ] = "two-way-natural",
    sim: Sim = "highway-env",
    seed: Annotated[int, typer.Option(min=0, help="Which traffic there is on it.")] = 0,
    density: Density = 1.0,
    traffic: Traffic = "",
    noise_m: NoiseM = 0.0,
    noise_mps: NoiseMps = 0.0,
    dropout: Dropout = 0.0,
    duration: Annotated[
        float | None, typer.Option(min=1.0, help="End after this many seconds.", show_default="until Ctrl-C")
    ] = None,
    say: Annotated[str | None, typer.Option(metavar="TEXT", help="Say this to the car.")] = None,
    say_at: Annotated[float, typer.Option(min=0.0, help="When to say it, in seconds.")] = 3.0,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port on 127.0.0.1 to listen on; 0: any.")
    ] = DEFAULT_PORT,
    listen: Annotated[
        str | None,
        typer.Option(
            metavar="ENDPOINT",
            help="Let users in here, from other computers too: tls/0.0.0.0:7447, with --cert.",
            show_default="--port",
        ),
    ] = None,
    cert: Cert = None,
    key: CertKey = None,
    ca: Authority = None,
    name: CarName = None,
    as_json: Json = False,
    without: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Leave out sim, fast, slow, llm or record; may be repeated."),
    ] = None,
    realtime: Annotated[
        str,
        typer.Option(
            help="Scheduling of sim and fast: fifo (real-time, where permitted), user (what a plain user may), off, or "
            "auto: the best there is."
        ),
    ] = "auto",
    policy: Annotated[
        str | None,
        typer.Option(
            "--policy",
            "--checkpoint",
            metavar="SPEC",
            help="What drives, always behind the mask: "
            "fastslow (ours), rule, constant:faster,left, random:SEED, ppo-masked (or dqn-, a2c-; or -bare), the path "
            "of a checkpoint, or your own as MODULE:FACTORY.",
            show_default="fastslow",
        ),
    ] = None,
    cockpit: Annotated[bool, typer.Option(help="Serve the page that shows the car, on this computer only.")] = True,
    cockpit_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Where it is served; if that is held, or 0: any free port.")
    ] = 8000,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Serve Foxglove and Lichtblick, too, on this computer only.")
    ] = False,
    record: Annotated[
        Path | None,
        typer.Option(metavar="FILE.mcap", help="Record to this file.", show_default="runs/.../recording.mcap"),
    ] = None,
    no_record: Annotated[bool, typer.Option("--no-record", help="Do not record.")] = False,
    record_max_mb: Annotated[
        float, typer.Option(min=1.0, help="For all recordings in runs/ together: the oldest are removed.")
    ] = 300.0,
    logs_max_mb: Annotated[
        float, typer.Option(min=1.0, help="For the logs of all runs in runs/ together, when one begins: likewise.")
    ] = 100.0,
    model: ModelName = None,
    base_url: BaseUrl = None,
    budget_s: BudgetS = None,
    max_tokens: MaxTokens = None,
) -> None:
    """Start the simulator, the fast and the slow node, the language model and the cockpit, and watch over them."""
    from deploy.run.processes import NAMES, SIMS, ModelOptions, RunOptions

    unknown = sorted(set(without or ()) - set(NAMES))
    if unknown:
        raise typer.BadParameter(f"{', '.join(unknown)}: choose from {', '.join(NAMES)}", param_hint="'--without'")
    if record is not None and no_record:
        raise typer.BadParameter("contradicts --record: leave one out", param_hint="'--no-record'")
    from schemas.runtime.realtime import MODES

    if sim not in SIMS:
        raise typer.BadParameter(f"{sim}: choose from {', '.join(SIMS)}", param_hint="'--sim'")
    if realtime not in MODES:
        raise typer.BadParameter(f"{realtime}: choose from {', '.join(MODES)}", param_hint="'--realtime'")
    tls = _certificates(listen, cert, key, ca, name)
    from deploy.run.system import run_system

    raise typer.Exit(
        run_system(
            RunOptions(
                scenario=scenario,
                sim=sim,
                seed=seed,
                duration_s=duration,
                port=port,
                listen=listen or "",
                tls=tls,
                name=name or "",
                say=None if say is None else sayable(say, "--say"),
                say_at_s=say_at,
                as_json=as_json,
                without=(*(without or ()), *(("record",) if no_record else ())),
                realtime=realtime,
                policy=policy or "fastslow",
                density=density,
                traffic=names(traffic),
                noise_m=noise_m,
                noise_mps=noise_mps,
                dropout=dropout,
                cockpit_port=cockpit_port if cockpit else None,
                foxglove=foxglove,
                record=record,
                record_max_mb=record_max_mb,
                logs_max_mb=logs_max_mb,
                model=ModelOptions(name=model, base_url=base_url, budget_s=budget_s, max_tokens=max_tokens),
            )
        )
    )


@commands.command(
    epilog='Examples:\n\n  fastslow say "I\'m in a hurry"\n\n'
    '  fastslow say --wait --json "please slow down a little"\n\n' + EXITS
)
def say(
    text: Annotated[str, typer.Argument(help="What the passenger says.")],
    wait: Annotated[bool, typer.Option("--wait", help="Wait until it is fulfilled, expired or failed.")] = False,
    timeout: Annotated[
        float | None, typer.Option(min=0.1, help="Seconds to wait.", show_default="15; with --wait 90")
    ] = None,
    port: Port = DEFAULT_PORT,
    connect: Connect = None,
    cert: Cert = None,
    key: CertKey = None,
    ca: Authority = None,
    name: CarName = None,
    as_json: Json = False,
) -> None:
    """Say something to the car that is running, and hear its answer."""
    from deploy.run import passenger as talk

    timeout_s = timeout if timeout is not None else 90.0 if wait else 15.0
    raise typer.Exit(
        talk.say(
            sayable(text, "TEXT"),
            car=_car(port, connect, cert, key, ca, name),
            wait=wait,
            timeout_s=timeout_s,
            as_json=as_json,
        )
    )


@commands.command(
    epilog="Examples:\n\n  fastslow status\n\n  fastslow status --watch\n\n"
    "  fastslow status --watch --json    (a line each second)\n\n" + EXITS
)
def status(
    port: Port = DEFAULT_PORT,
    connect: Connect = None,
    cert: Cert = None,
    key: CertKey = None,
    ca: Authority = None,
    name: CarName = None,
    as_json: Json = False,
    watch: Annotated[bool, typer.Option("--watch", help="Again each second, until Ctrl-C.")] = False,
) -> None:
    """Show the nodes of the running system and their metrics."""
    from deploy.run import passenger as talk

    raise typer.Exit(talk.status(car=_car(port, connect, cert, key, ca, name), as_json=as_json, watch=watch))


@commands.command(
    epilog="Examples:\n\n  fastslow doctor\n\n  fastslow doctor --json\n\n"
    "  fastslow doctor --base-url localhost:11434 --model qwen3:8b\n\n" + EXITS
)
def doctor(
    port: Port = DEFAULT_PORT,
    as_json: Json = False,
    model: ModelName = None,
    base_url: BaseUrl = None,
    budget_s: BudgetS = None,
    max_tokens: MaxTokens = None,
) -> None:
    """Check that everything a run needs is here, an endpoint by one word, and say how to mend what is not."""
    from deploy.run.doctor import doctor as examine
    from deploy.run.processes import ModelOptions

    asked = ModelOptions(name=model, base_url=base_url, budget_s=budget_s, max_tokens=max_tokens)
    raise typer.Exit(examine(port=port, as_json=as_json, model=asked))
