"""`fastslow memory`: look into the memory bank, and edit it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deploy.cli.bounded import Commands
from schemas.runtime.files import lines_bounded
from schemas.wire.text import json_line, plain

if TYPE_CHECKING:
    from slow_node.memory.bank import Example, Memory

app = Commands(
    name="memory", help="Look into what the car remembers, and edit it.", no_args_is_help=True, rich_markup_mode=None
)

LINE_BYTES, EXAMPLES_MOST = 100_000, 20_000
"""Of an example on file, and of a file, at most."""
Bank = Annotated[Path | None, typer.Option(help="The bank's SQLite file.", show_default="the one that runs use")]
Json = Annotated[bool, typer.Option("--json", help="Data as JSON on stdout.")]


@contextmanager
def _bank(path: Path | None) -> Iterator[Memory]:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy loads
    from deploy.run.processes import data_folder
    from schemas.runtime.process import CONFIG, ConfigError
    from slow_node.llm.embedding import load_embedder
    from slow_node.memory.bank import Memory

    path = path or data_folder() / "memory.sqlite"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        memory = Memory(load_embedder(), str(path))
    except (OSError, ConfigError) as error:
        typer.echo(f"fastslow: {error}", err=True)
        raise typer.Exit(CONFIG) from None
    try:
        yield memory
    finally:
        memory.close()


def _row(example: Example) -> dict[str, Any]:
    from slow_node.memory.bank import Row

    row = {**Row.of(example).model_dump(), "slots": json.loads(example.slots.compact())}
    return {**row, "lesson": example.lesson} if example.lesson else row


def _seconds(value: float | None) -> str:
    return "     -" if value is None else f"{value:>4} s"


@app.command("list")
def list_(
    bank: Bank = None,
    as_json: Json = False,
    shipped: Annotated[bool, typer.Option("--shipped", help="What was shipped as well.")] = False,
) -> None:
    """What was learnt on the road.

    A line is: id, how often fulfilled, last outcome, its time, smallest time to collision, command, decision.
    """
    with _bank(bank) as memory:
        rows = [_row(e) for e in memory.examples() if shipped or not e.shipped]
    if as_json:
        typer.echo(json_line(rows))
        return
    for row in rows:
        times = f"{row['fulfilled']}/{row['fulfilled'] + row['failed']}"
        typer.echo(
            f"{row['id']:>5}  {times:>5}  {row['outcome']:<12} {row['took_s']:>6} s  "
            f"TTC {_seconds(row['min_ttc_s'])}  {plain(row['command'])}  {row['slots']}"
            + (f"  next time: {row['lesson']}" if "lesson" in row else "")
        )
    typer.echo(_counted(len(rows)), err=True)


@app.command()
def show(
    command: Annotated[str, typer.Argument(help="A command.")],
    k: Annotated[int, typer.Option(min=1)] = 4,
    bank: Bank = None,
) -> None:
    """What the car would recall for a command, nearest first, as JSON lines."""
    with _bank(bank) as memory:
        for example in memory.nearest(command, k):
            typer.echo(json_line({"cosine": round(example.cosine, 3), **_row(example)}))


@app.command()
def forget(
    identity: Annotated[str, typer.Argument(metavar="ID|KIND", help="As `list` or `preferences` shows it.")],
    bank: Bank = None,
) -> None:
    """Remove one example, or a preference. A shipped example comes back with the next start."""
    with _bank(bank) as memory:
        gone = memory.forget(int(identity)) if identity.isdecimal() else memory.drop(identity)
    if not gone:
        where = "list --shipped" if identity.isdecimal() else "preferences"
        typer.echo(f"fastslow: there is no example or preference {identity}; see: fastslow memory {where}", err=True)
        raise typer.Exit(1)


@app.command()
def preferences(bank: Bank = None, as_json: Json = False) -> None:
    """What the passenger prefers on every drive: its kind, what the car does for it, and the words that said so."""
    from slow_node.memory.preferences import KINDS

    with _bank(bank) as memory:
        kept = memory.preferences()
    if as_json:
        typer.echo(json_line([{"kind": one.kind, "does": KINDS[one.kind], "said": one.said} for one in kept]))
        return
    for one in kept:
        typer.echo(f"{one.kind:<12} {KINDS[one.kind]:<38} {plain(one.said)}")
    typer.echo(f"{len(kept)} preferences", err=True)


@app.command()
def prefer(kind: Annotated[str, typer.Argument(help="gentle, room or no_passing.")], bank: Bank = None) -> None:
    """Have the car drive so on every drive; `forget KIND` takes it back. A passenger says it: "I get carsick"."""
    from slow_node.memory.preferences import KINDS, Preference

    if kind not in KINDS:
        typer.echo(f"fastslow: {kind}: choose from {', '.join(KINDS)}", err=True)
        raise typer.Exit(2)
    with _bank(bank) as memory:
        memory.prefer(Preference(kind, "by hand"))


@app.command()
def export(target: Annotated[str, typer.Argument(help='A file, or "-".')] = "-", bank: Bank = None) -> None:
    """Write what was learnt as JSON lines."""
    with _bank(bank) as memory:
        lines = "".join(json_line(_row(e)) + "\n" for e in memory.examples() if not e.shipped)
    if target == "-":
        sys.stdout.write(lines)
    else:
        with _usable(target):
            Path(target).write_text(lines, "utf-8")


@app.command("import")
def import_(
    source: Annotated[str, typer.Argument(help='JSON lines as `export` writes them, or "-".')], bank: Bank = None
) -> None:
    """Learn examples from a file; what the bank knows already is merged. Nothing is kept unless every line is good."""
    from slow_node.memory.bank import Row

    examples: list[Example] = []
    with _usable(source), nullcontext(sys.stdin.buffer) if source == "-" else open(source, "rb") as opened:
        for number, line in enumerate(lines_bounded(opened, LINE_BYTES), 1):
            if line is not None and not line.strip():
                continue
            if line is None or len(examples) >= EXAMPLES_MOST:
                most = f"{LINE_BYTES:,} bytes" if line is None else f"{EXAMPLES_MOST:,} examples, ten times a bank's"
                raise _wrong(f"line {number}: more than {most}")
            text = line.decode()
            try:
                examples.append(Row.model_validate_json(text).learnt())
            except ValueError as error:
                raise _wrong(f"line {number}: {_reason(error)}") from None
    with _bank(bank) as memory:
        stored = memory.add(examples)
    typer.echo(f"{_counted(stored)} imported from {len(examples)} lines", err=True)


def _counted(count: int) -> str:
    return f"{count} example{'' if count == 1 else 's'}"


def _reason(error: ValueError) -> str:
    """One line: of pydantic's several, the first field and what is wrong with it."""
    from pydantic import ValidationError

    if not isinstance(error, ValidationError):
        return str(error)
    first = error.errors()[0]
    return ": ".join(filter(None, [".".join(map(str, first["loc"])), first["msg"]]))


def _wrong(why: str) -> typer.Exit:
    typer.echo(f"fastslow: {why}", err=True)
    return typer.Exit(2)


@contextmanager
def _usable(file: str) -> Iterator[None]:
    """A file that cannot be read or written is the caller's mistake: one line and exit code 2."""
    try:
        yield
    except (OSError, UnicodeDecodeError) as error:
        raise _wrong(f"{file}: {getattr(error, 'strerror', None) or 'this is no UTF-8 text'}") from None
