"""The memory bank: what it keeps of the road, and how it warns."""

from __future__ import annotations

import math
import sqlite3
from pathlib import Path

import pytest

from slow_node.llm.embedding import HashedEmbedder, load_embedder
from slow_node.memory.bank import Memory
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
