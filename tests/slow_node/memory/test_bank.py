"""The memory bank: what it keeps of the road, and how it warns."""

from __future__ import annotations

import math
import os
import sqlite3
from pathlib import Path

import pytest

from schemas.runtime.errors import ConfigError
from slow_node.llm.embedding import HashedEmbedder, load_embedder
from slow_node.memory.bank import FILE_BYTES, Memory
from slow_node.memory.examples import read_shipped
from slow_node.planning.prompt import build_prompt
from slow_node.understanding.slots import Slots
from tests.faulty_server import SLOWER

SLOW = Slots(outcome="directive", speed="slower")
FAST = Slots(outcome="directive", speed="faster")


def test_a_paraphrase_finds_its_example() -> None:
    memory = Memory(load_embedder())
    assert memory.nearest("would you slow down a little", 1)[0].slots.speed == "slower"
    memory.close()


def test_a_like_command_with_the_same_decision_is_the_same_experience(memory: Memory) -> None:
    memory.learn("take the scenic pace", "two-way", SLOW, "fulfilled", 2.0)
    memory.learn("take the scenic pace!", "two-way", SLOW, "expired, held up by rear gap", 30.0)
    (merged,) = memory.examples()
    assert (merged.took_s, merged.fulfilled, merged.failed) == (30.0, 1, 1)


def test_what_a_model_has_said_is_never_a_turn_of_another_ones_prompt(memory: Memory, tmp_path: Path) -> None:
    said = SLOW.model_copy(update={"reasoning": "as the first model thought", "say": "as the first model said"})
    memory.learn("take the scenic pace", "two-way", said, "fulfilled")
    old = Memory(HashedEmbedder(), str(tmp_path / "bank.sqlite"), shipped=None)
    old.learn("take the scenic pace", "two-way", SLOW, "fulfilled")
    old._db.execute("UPDATE experience SET slots = ?", (said.compact(),))  # as earlier versions have kept it
    old._db.commit()
    old._load()
    for bank in (memory, old):
        prompt = build_prompt("scenic", "two-way", bank.nearest("take the scenic pace", 1), {}, short=False)
        assert '"speed":"slower"' in prompt[2]["content"]
        assert "first model" not in str(prompt)
    old.close()


def test_the_newest_reading_of_the_same_words_counts(memory: Memory) -> None:
    memory.learn("take the scenic pace", "two-way", FAST, "fulfilled")
    memory.learn("take the scenic pace", "two-way", SLOW, "fulfilled")
    assert [one.slots.speed for one in memory.examples()] == ["slower"]


def test_a_failure_is_recalled_as_a_warning_in_the_prompt(memory: Memory) -> None:
    memory.learn("take the scenic pace", "two-way", SLOW, "expired, held up by rear gap", 30.0)
    prompt = build_prompt("scenic", "two-way", memory.nearest("take the scenic pace", 1), {}, short=True)
    assert "Note: last time: expired, held up by rear gap\n" in prompt[1]["content"]


def test_a_later_success_does_not_erase_a_failure(memory: Memory) -> None:
    for outcome in ("expired, held up by rear gap", "fulfilled", "fulfilled"):
        memory.learn("take the scenic pace", "two-way", SLOW, outcome)
    assert memory.examples()[0].warning == "before: expired, held up by rear gap (1 of 3 times)"


def test_a_near_miss_is_recalled_as_a_warning_even_where_the_wish_came_true(memory: Memory) -> None:
    memory.learn("press on, driver", "two-way", FAST, "fulfilled", 4.0, 1.2)
    assert memory.examples()[0].warning == "last time: near miss, 1.2 s from a collision"


def test_a_later_success_does_not_erase_a_near_miss(memory: Memory) -> None:
    memory.learn("press on, driver", "two-way", FAST, "fulfilled", 4.0, 1.2)
    memory.learn("press on, driver", "two-way", FAST, "fulfilled", 4.0, 8.0)
    assert memory.examples()[0].warning == "before: near miss, 1.2 s from a collision"


@pytest.mark.parametrize(
    ("outcome", "warning"),
    [
        ("superseded", ""),
        ("cancelled", ""),
        ("cancelled, held up by rear gap", "last time: cancelled, held up by rear gap"),
    ],
)
def test_a_wish_that_was_given_up_is_a_warning_only_where_a_rule_held_it_up(
    outcome: str, warning: str, memory: Memory
) -> None:
    memory.learn("press on, driver", "two-way", FAST, outcome, 4.0, 8.0)
    assert memory.examples()[0].warning == warning


def test_what_only_went_well_carries_no_warning(memory: Memory) -> None:
    for _ in range(2):
        memory.learn("press on, driver", "two-way", FAST, "fulfilled", 4.0, 8.0)
    assert memory.examples()[0].warning == ""


def test_beyond_its_bound_the_bank_loses_the_oldest(memory: Memory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slow_node.memory.bank.MAX_LEARNT", 3)
    for word in ("alpha", "beta", "gamma", "delta", "epsilon"):
        memory.learn(f"{word} pace", "two-way", SLOW, "fulfilled")
    assert [one.command for one in memory.examples()] == ["gamma pace", "delta pace", "epsilon pace"]


def test_shipped_examples_do_not_count_towards_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slow_node.memory.bank.MAX_LEARNT", 1)
    memory = Memory(HashedEmbedder())
    shipped = len(memory)
    memory.learn("alpha pace", "two-way", SLOW, "fulfilled")
    memory.learn("beta pace", "two-way", SLOW, "fulfilled")
    assert len(memory) == shipped + 1
    memory.close()


def test_an_example_can_be_forgotten_once(memory: Memory) -> None:
    memory.learn("alpha pace", "two-way", SLOW, "fulfilled")
    identity = memory.examples()[0].id
    assert [memory.forget(identity), memory.forget(identity), len(memory)] == [True, False, 0]


def test_the_outcome_of_a_shipped_command_is_kept_beside_the_shipped_one(tmp_path: Path) -> None:
    seed = read_shipped()[0]
    for _ in range(2):  # the second time it is planted into a bank that has learnt
        memory = Memory(HashedEmbedder(), str(tmp_path / "bank.sqlite"))
        memory.learn(seed.command, "two-way", seed.slots, "expired")
        memory.close()
    memory = Memory(HashedEmbedder(), str(tmp_path / "bank.sqlite"))
    same = [one for one in memory.nearest(seed.command, 3) if one.command == seed.command]
    memory.close()
    assert [(one.shipped, one.failed) for one in same] == [(True, 0), (False, 2)]


def test_two_processes_may_learn_into_one_bank(tmp_path: Path) -> None:
    path = str(tmp_path / "bank.sqlite")
    here, there = (Memory(HashedEmbedder(), path, None) for _ in range(2))
    here.learn("press on, driver", "two-way", FAST, "fulfilled", 4.0, 1.2)
    there.learn("press on, driver", "two-way", FAST, "fulfilled")
    assert [(one.fulfilled, one.min_ttc_s) for one in there.examples()] == [(2, 1.2)]
    here.close()
    there.close()


@pytest.mark.parametrize("keeps_ttc", [False, True], ids=["first", "with time to collision"])
def test_a_bank_of_an_older_release_keeps_its_examples(keeps_ttc: bool, tmp_path: Path) -> None:
    path = tmp_path / "bank.sqlite"
    embedder = HashedEmbedder()
    old = sqlite3.connect(path)
    old.execute(
        "CREATE TABLE experience (space TEXT, command TEXT, scene TEXT, slots TEXT, outcome TEXT, took_s REAL,"
        f" vector BLOB{', min_ttc_s REAL' if keeps_ttc else ''}, PRIMARY KEY (space, command))"
    )
    for command, outcome in (("shipped pace", "seed"), ("scenic pace", "expired"), ("brisk trot", "fulfilled")):
        row = (embedder.name, command, "", SLOWER, outcome, 3.0, embedder.embed(command).tobytes())
        old.execute(f"INSERT INTO experience VALUES (?, ?, ?, ?, ?, ?, ?{', 1.2' if keeps_ttc else ''})", row)
    old.commit()
    old.close()
    for _ in range(2):
        memory = Memory(embedder, str(path), None)
        kept = [(one.outcome, one.fulfilled, one.failed, one.trouble, one.min_ttc_s) for one in memory.examples()]
        memory.close()
        ttc = 1.2 if keeps_ttc else math.inf
        assert kept == [("seed", 0, 0, "", ttc), ("expired", 0, 1, "expired", ttc), ("fulfilled", 1, 0, "", ttc)]


def bad_banks(folder: Path) -> dict[str, Path]:
    """Files that are no bank of ours, or no longer."""
    there = {name: folder / f"{name}.sqlite" for name in ("foreign", "torn", "text", "vector", "nan", "words", "pipe")}
    for name in ("torn", "vector", "nan", "words"):
        Memory(HashedEmbedder(), str(there[name]), None).close()
    with sqlite3.connect(there["foreign"]) as db:
        db.execute("CREATE TABLE bookmarks (url TEXT)")
    there["torn"].write_bytes(there["torn"].read_bytes()[:5000])
    there["text"].write_text("no database at all " * 100)
    row = [HashedEmbedder.name, "c", "s", '{"outcome":"unclear"}', "fulfilled", 0.0, None, 1, 0, "", bytes(4 * 384)]
    for name, place, value in (("vector", -1, b"xx"), ("nan", -1, b"\xff" * 4 * 384), ("words", 5, "soon")):
        changed = [*row]
        changed[place] = value
        with sqlite3.connect(there[name]) as db:
            names = "space, command, scene, slots, outcome, took_s, min_ttc_s, fulfilled, failed, trouble, vector"
            db.execute(f"INSERT INTO experience ({names}) VALUES ({', '.join('?' * 11)})", changed)
    os.mkfifo(there["pipe"])
    return there


@pytest.mark.parametrize("kind", ["foreign", "torn", "text", "vector", "nan", "words", "pipe"])
def test_what_is_no_bank_is_refused_in_one_line_and_left_as_it_is(kind: str, tmp_path: Path) -> None:
    path = bad_banks(tmp_path)[kind]
    before = b"" if kind == "pipe" else path.read_bytes()
    with pytest.raises(ConfigError, match="give another path") as refused:
        Memory(HashedEmbedder(), str(path), None)
    assert str(path) in str(refused.value)
    assert kind == "pipe" or path.read_bytes() == before


def test_a_bank_that_another_process_holds_is_not_to_be_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bank.sqlite"
    Memory(HashedEmbedder(), str(path), None).close()
    holder, connect = sqlite3.connect(path), sqlite3.connect
    holder.execute("BEGIN EXCLUSIVE")
    monkeypatch.setattr(sqlite3, "connect", lambda path, **more: connect(path, timeout=0.0, **more))
    with pytest.raises(ConfigError, match="another process holds it"):
        Memory(HashedEmbedder(), str(path), None)
    holder.close()


def test_a_bank_larger_than_any_of_ours_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "bank.sqlite"
    with path.open("wb") as file:
        file.truncate(FILE_BYTES + 1)
    with pytest.raises(ConfigError, match="larger than"):
        Memory(HashedEmbedder(), str(path), None)
