"""What several commands share: options, exit codes, and how an early end is told."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer

DEFAULT_PORT = 7447
EXITS = (
    "Exit codes: 0 ok, 1 failed, 2 usage, 69 no system there, 75 try again (port taken), "
    "78 bad configuration or model, 130/143 signals."
)
Port = Annotated[int, typer.Option(min=1, max=65535, help="TCP port on 127.0.0.1 where the system listens.")]
Connect = Annotated[
    str | None,
    typer.Option(metavar="ENDPOINT", help="A car elsewhere: tls/HOST:PORT, with --cert.", show_default="--port"),
]
Cert = Annotated[
    str | None, typer.Option(metavar="FILE.pem", help="Our certificate, whose common name is our role: passenger, ...")
]
CertKey = Annotated[str | None, typer.Option("--key", metavar="FILE.key", help="Its key.", show_default="beside it")]
Authority = Annotated[
    str | None,
    typer.Option("--ca", metavar="FILE.pem", help="The authority of both sides.", show_default="ca.pem beside it"),
]
CarName = Annotated[str | None, typer.Option("--name", metavar="NAME", help="Of the car, where it has one: car-7.")]
Density = Annotated[float, typer.Option(min=0.2, max=3.0, help="Of the traffic: times the road's own.")]
Traffic = Annotated[
    str,
    typer.Option(
        metavar="NAME[,NAME...]",
        help="Other traffic: idm30, hard-brakes, trucks, narrow, sway, or several.",
        show_default="the road's own",
    ),
]
Sim = Annotated[
    str, typer.Option(metavar="NAME", help="Whose drivers are in the other cars: highway-env or sumo (extra sumo).")
]
NoiseM = Annotated[float, typer.Option(min=0.0, max=100.0, help="Error of perceived positions, standard deviation.")]
NoiseMps = Annotated[float, typer.Option(min=0.0, max=100.0, help="Error of perceived speeds, standard deviation.")]
Dropout = Annotated[float, typer.Option(min=0.0, max=0.9, help="Chance that a car goes unseen at a tick.")]
ModelName = Annotated[
    str | None,
    typer.Option(
        "--model", metavar="NAME", help="The endpoint's model.", show_default="OPENAI_MODEL, or the only one it serves"
    ),
]
BaseUrl = Annotated[
    str | None,
    typer.Option(
        metavar="URL",
        help="Any OpenAI-compatible endpoint, such as http://127.0.0.1:11434/v1; a key is read from OPENAI_API_KEY.",
        show_default="OPENAI_BASE_URL; or OpenAI, with a key; or OLLAMA_HOST; or none: the embedded model",
    ),
]
BudgetS = Annotated[
    float | None,
    typer.Option(
        min=0.5, max=300.0, metavar="S", help="How long the model may take for one command.", show_default="8"
    ),
]
MaxTokens = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=1_000_000,
        metavar="N",
        help="Of the model's answer, its thoughts included.",
        show_default="2000; embedded 120",
    ),
]
Ray = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Spread the work over a Ray cluster: HOST:PORT, auto for the one this machine belongs to, or local to "
        "start one here.",
        show_default="none: here",
    ),
]
Full = Annotated[bool, typer.Option("--full", help="All of every prompt and answer.")]
Json = Annotated[bool, typer.Option("--json", help="Data as JSON on stdout; everything else on stderr.")]


def names(several: str) -> tuple[str, ...]:
    """Of an option that takes several, separated by commas."""
    return tuple(name for name in several.split(",") if name)


@contextmanager
def readable_ends() -> Iterator[None]:
    """What ends learning or evaluation early is one line and an exit code."""
    from schemas.runtime.process import CONFIG, ConfigError, Stopped, stop_on_signals

    try:
        with stop_on_signals():
            yield
    except Stopped as stopped:
        raise typer.Exit(stopped.code) from None
    except ImportError as error:
        extra = {"imageio_ffmpeg": "view", "matplotlib": "view", "wandb": "track"}.get(error.name or "", "train")
        typer.echo(f"fastslow: {error.name} is missing: pip install 'fastslow[{extra}]'", err=True)
        raise typer.Exit(CONFIG) from None
    except ConfigError as error:
        typer.echo(f"fastslow: {error}", err=True)
        raise typer.Exit(CONFIG) from None
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def sayable(text: str, option: str) -> str:
    """What is said, as the shell wrote it: a locale without letters hands it over in bytes. Ends with 2 for a text that
    cannot be said."""
    import os

    from schemas.wire.codec import Fault, encode
    from schemas.wire.messages import Command

    try:
        text = text if text.isascii() else os.fsencode(text).decode()
    except UnicodeEncodeError:  # it has letters already
        pass
    except UnicodeDecodeError:
        raise typer.BadParameter("this is no UTF-8 text", param_hint=f"'{option}'") from None
    try:
        encode(Command(epoch=0, stamp_ns=0, id=2**48, text=text, source="run"))
    except (Fault, UnicodeEncodeError) as error:
        raise typer.BadParameter(f"this cannot be said: {error}", param_hint=f"'{option}'") from None
    return text
