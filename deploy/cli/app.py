"""The command line, `fastslow`. Everything heavy is imported inside the commands: `--help` must be quick."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from deploy.cli.bench import app as bench
from deploy.cli.driving import commands as driving
from deploy.cli.judging import commands as judging
from deploy.cli.learning import commands as learning
from deploy.cli.memory import app as memory
from deploy.cli.options import EXITS
from deploy.cli.recordings import commands as recordings
from deploy.cli.showing import commands as showing
from deploy.cli.thinking import commands as thinking

app = typer.Typer(
    name="fastslow",
    help="A car that drives fast, thinks slowly and listens to its passenger.",
    epilog="Examples:\n\n  fastslow run\n\n"
    '  fastslow say "I\'m in a hurry to get to work, I want to drive faster"\n\n' + EXITS,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for group in (driving, recordings, showing, thinking, learning, judging):
    app.add_typer(group)
app.add_typer(bench)
app.add_typer(memory)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"fastslow {version('fastslow')}")
        except PackageNotFoundError:
            print("fastslow (not installed: run from its source folder)")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    pass


def main() -> None:
    """The entry point. Ctrl-C in a short command is an exit code, not a traceback."""
    try:
        app()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
