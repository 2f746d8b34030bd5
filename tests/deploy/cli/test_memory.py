"""`fastslow memory`: how people edit the bank."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from deploy.cli.memory import app
from slow_node.llm.embedding import HashedEmbedder
from slow_node.memory.bank import Memory, experience
from slow_node.understanding.slots import Slots
from tests.faulty_server import SLOWER

SLOW = Slots(outcome="directive", speed="slower")


def cli(*words: str, bank: Path) -> tuple[int, str]:
    """`fastslow memory ...`: its exit code, and what it printed."""
    result = CliRunner().invoke(app, [*words, "--bank", str(bank)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


@pytest.fixture
def bank(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The path of a bank that the command line uses, with quick embeddings."""
    monkeypatch.setattr("slow_node.llm.embedding.load_embedder", HashedEmbedder)
    return tmp_path / "bank.sqlite"


def line(**changes: object) -> str:
    """A line of an export."""
    row = {"command": "scenic pace", "scene": "two-way", "slots": json.loads(SLOWER), "outcome": "fulfilled"}
    return json.dumps({**row, **changes})


def imported(bank: Path, *lines: str) -> tuple[int, str]:
    source = bank.with_suffix(".jsonl")
    source.write_text("\n".join(lines), "utf-8")
    return cli("import", str(source), bank=bank)


def test_a_damaged_bank_is_refused_in_one_line(bank: Path) -> None:
    Memory(HashedEmbedder(), str(bank), None).close()
    database = sqlite3.connect(bank)
    database.execute("INSERT INTO experience (space, slots) VALUES (?, 'no JSON')", (HashedEmbedder.name,))
    database.commit()
    database.close()
    code, said = cli("list", bank=bank)
    assert (code, said.count("\n")) == (78, 1)


def test_what_is_exported_and_imported_again_is_the_same(bank: Path) -> None:
    memory = Memory(HashedEmbedder(), str(bank))
    memory.add(
        [
            experience("scenic\u2028pace", "two-way", SLOW, "expired, held up by rear gap", 2.0, 1.2),
            experience("scenic\u2028pace", "two-way", SLOW, "fulfilled", 2.0),
        ]
    )
    warning = memory.examples()[-1].warning
    memory.close()
    target = bank.with_suffix(".jsonl")
    cli("export", str(target), bank=bank)
    other = bank.with_name("other.sqlite")
    cli("import", str(target), bank=other)
    memory = Memory(HashedEmbedder(), str(other))
    assert (memory.examples()[-1].command, memory.examples()[-1].warning) == ("scenic\u2028pace", warning)
    memory.close()


def test_only_examples_that_were_stored_are_counted_as_imported(bank: Path) -> None:
    code, said = imported(bank, line(), line(command="scenic pace!"), line(command="brisk trot"))
    assert (code, said) == (0, "2 examples imported from 3 lines\n")


def test_examples_beyond_the_bound_are_not_counted(bank: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slow_node.memory.bank.MAX_LEARNT", 1)
    assert imported(bank, line(), line(command="brisk trot"))[1] == "1 example imported from 2 lines\n"


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (line(outcome="seed"), "shipped"),
        (line(outcome=""), "outcome"),
        (line(took_s=math.nan), "took_s"),
        (line(min_ttc_s=-1), "min_ttc_s"),
        (line(slots={"outcome": "fly"}), "slots.outcome"),
        ("{", "JSON"),
        (line(command="x" * 5000), "command"),
    ],
    ids=["seed", "no outcome", "NaN", "negative", "slots", "JSON", "long"],
)
def test_a_bad_line_is_refused_with_its_number(bad: str, why: str, bank: Path) -> None:
    code, said = imported(bank, line(), bad)
    assert (code, said.count("\n")) == (2, 1)
    assert said.startswith("fastslow: line 2: ")
    assert why in said


def test_nothing_is_kept_of_a_file_with_a_bad_line(bank: Path) -> None:
    imported(bank, line(), "{")
    assert json.loads(cli("list", "--json", bank=bank)[1]) == []


def missing(folder: Path) -> list[str]:
    return ["import", str(folder / "missing.jsonl")]


def no_text(folder: Path) -> list[str]:
    (folder / "binary.jsonl").write_bytes(b"\xff\xfe\x00")
    return ["import", str(folder / "binary.jsonl")]


def unwritable(folder: Path) -> list[str]:
    return ["export", str(folder / "missing" / "export.jsonl")]


@pytest.mark.parametrize("words", [missing, no_text, unwritable])
def test_a_file_that_cannot_be_used_is_named_in_one_line(words: Callable[[Path], list[str]], bank: Path) -> None:
    code, said = cli(*words(bank.parent), bank=bank)
    assert (code, said.count("\n")) == (2, 1)
    assert said.startswith(f"fastslow: {bank.parent}")
