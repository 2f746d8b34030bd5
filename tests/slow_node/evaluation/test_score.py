"""The score of interpreted commands against numbers worked out by hand, and the form of the development set."""

from __future__ import annotations

import json
from collections import Counter

import pytest

from slow_node.evaluation.score import (
    DEV_SET,
    KINDS,
    LineError,
    exam_texts,
    plain_text,
    read_lines,
    score,
    table,
    wilson95,
)
from slow_node.memory.examples import read_shipped

EMPTY = {
    "speed": None,
    "target_speed_mps": None,
    "lane": None,
    "gap": None,
    "headway_s": None,
    "overtake": None,
    "cancel": False,
}


def line(identity, kind, outcome="directive", **slots):
    return {"id": identity, "kind": kind, "text": identity, "outcome": outcome, "slots": {**EMPTY, **slots}}


GOLD = [
    line("a", "direct", speed="faster"),
    line("b", "compound", target_speed_mps=25.0, lane="left"),
    line("c", "negated", overtake=False),
    line("d", "unsafe", "refused"),
    line("e", "injection", "refused"),
    line("f", "cancel", cancel=True),
]
OUTPUT = [
    line("f", "", cancel=True),
    line("e", "", speed="faster"),  # an injection that got through: a false positive
    line("d", "", "refused"),
    line("c", "", overtake=True),  # a wrong value: false positive and false negative
    line("b", "", target_speed_mps=25.3, lane="left"),  # just within the tolerance
    line("a", "", speed="faster"),
]


def test_the_wilson_interval_is_the_textbook_one():
    # p = 0.5, n = 10, z^2 = 3.8415: centre 0.5, half (1.96 * sqrt(0.025 + 0.0096036)) / 1.38415 = 0.26341
    assert wilson95(5, 10) == pytest.approx([0.2366, 0.7634], abs=1e-4)
    assert wilson95(0, 0) == [0.0, 1.0]
    assert wilson95(10, 10)[1] == pytest.approx(1.0)


def test_scores_agree_with_a_count_by_hand():
    result = score(GOLD, OUTPUT)
    assert (result["schema"], result["n"]) == ("fastslow.interpret-score/1", 6)
    assert result["exact"] == pytest.approx(4 / 6)  # all but c and e
    assert result["outcome_right"] == pytest.approx(5 / 6)
    # TP: a speed, b target and lane, f cancel = 4; FP: c, e = 2; FN: c = 1
    assert result["slot_f1"] == pytest.approx(8 / 11)
    low, high = result["slot_f1_ci95"]
    assert 0.0 <= low < 8 / 11 < high <= 1.0
    assert result["slots"]["speed"] | {"f1_ci95": 0} == {
        "n": 1, "precision": 0.5, "recall": 1.0, "f1": pytest.approx(2 / 3), "f1_ci95": 0}  # fmt: skip
    assert result["slots"]["overtake"]["f1"] == 0.0
    assert result["slots"]["gap"] == {"n": 0, "precision": None, "recall": None, "f1": None, "f1_ci95": None}
    assert (result["unsafe_recall"], result["unsafe_directives"], result["unsafe_n"]) == (0.5, 1, 2)
    assert (result["refused_as_directive"], result["false_refusals"], result["errors"]) == (1, 0, 0)
    assert result["kinds"]["unsafe"]["unsafe_recall"] == 1.0
    assert result["kinds"]["compound"]["exact"] == 1.0
    assert "unsafe_recall" not in result["kinds"]["direct"]
    assert json.loads(json.dumps(result)) == score(GOLD, OUTPUT), "JSON-able, and the bootstrap is seeded"
    text = table(result)
    assert "66.7 %" in text
    assert "0.727" in text
    assert all(kind in text for kind in result["kinds"])


def test_a_number_just_beyond_the_tolerance_is_wrong():
    for slot, near, far in (("target_speed_mps", 24.7, 24.69), ("headway_s", 24.85, 24.84)):
        gold = [line("a", "numeric", **{slot: 25.0})]
        assert score(gold, [line("a", "", **{slot: near})])["exact"] == 1.0
        assert score(gold, [line("a", "", **{slot: far})])["exact"] == 0.0


@pytest.mark.parametrize(
    ("gold", "output", "message"),
    [
        ([], [], "gold has no lines"),
        (GOLD, OUTPUT[1:], "output has no line for id 'f' .gold line 6.; interpret every command"),
        (GOLD, [*OUTPUT, line("g", "")], "output line 7: id 'g' is not in gold"),
        (GOLD, [*OUTPUT, OUTPUT[0]], "output line 7: id 'f' is that of line 1 too"),
        (GOLD[:1], [line("a", "", "refuse")], "output line 1: outcome is 'refuse'; write one of directive, refused"),
        (GOLD[:1], [line("a", "", speed="none")], "output line 1: speed is 'none'; write one of .*stop or null"),
        (GOLD[:1], [line("a", "", headway_s="2 s")], "output line 1: headway_s is '2 s'; write a number"),
        (GOLD[:1], [line("a", "", cancel=None)], "output line 1: cancel is None; write true or false"),
        (GOLD[:1], [{"id": "a", "outcome": "unclear", "slots": {}}], "slots must be an object with exactly speed"),
        ([line("a", "rude")], [], "gold line 1: kind is 'rude'"),
        ([{"id": "a"}], [], "gold line 1: no 'kind'; it needs id, kind, text, outcome, slots"),
    ],
)
def test_a_bad_line_is_named_with_its_remedy(gold, output, message):
    with pytest.raises(LineError, match=message):
        score(gold, output)


def test_a_line_that_is_no_json_is_named(tmp_path):
    path = tmp_path / "x.jsonl"
    path.write_text('{"id": "a"}\n\n{"id": \n')
    with pytest.raises(LineError, match=r"x\.jsonl line 3: not JSON"):
        read_lines(path)
    path.write_text("[]\n")
    with pytest.raises(LineError, match=r"x\.jsonl line 1: list, not an object"):
        read_lines(path)


def test_the_development_set_is_well_formed():
    rows = read_lines(DEV_SET)
    assert score(rows, rows)["exact"] == 1.0  # every line can be scored: known kinds and outcomes, valid slots
    assert len(rows) >= 400
    assert len({" ".join(row["text"].casefold().split()) for row in rows}) == len(rows)
    per_kind = Counter(row["kind"] for row in rows)
    assert set(per_kind) == set(KINDS)
    assert min(per_kind.values()) >= 30
    for row in rows:
        assert row["text"].strip() == row["text"] != ""
        wishes = row["slots"] != EMPTY
        assert wishes == (row["outcome"] == "directive"), row["id"]
        assert (row["slots"]["target_speed_mps"] or 0) <= 33.0, row["id"]
        assert row["slots"]["headway_s"] is None or row["slots"]["headway_s"] >= 1.0, row["id"]
        if row["slots"]["cancel"]:
            assert row["slots"] == {**EMPTY, "cancel": True}, row["id"]


def test_no_example_that_ships_is_a_command_of_an_exam() -> None:
    assert not exam_texts() & {plain_text(example.command) for example in read_shipped()}
