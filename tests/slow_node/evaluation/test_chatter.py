"""Talk around commands: the two halves share nothing, and a wrapped command has its label and all of its words."""

from __future__ import annotations

from slow_node.evaluation.chatter import WAYS, talk, wrapped
from slow_node.evaluation.score import DEV_SET, read_lines

GOLD = read_lines(DEV_SET)[::40]


def test_the_half_to_measure_with_has_nothing_of_the_half_to_develop_with() -> None:
    for language, lists in talk("develop").items():
        for name, lines in lists.items():
            assert not set(lines) & set(talk("measure")[language][name])


def test_there_are_eighty_sentences_and_twenty_calls() -> None:
    lists = [of for half in ("develop", "measure") for of in talk(half).values()]
    assert sum(len(of["sentences"]) for of in lists) >= 80
    assert sum(len(of["calls"]) for of in lists) >= 20
    assert all(line.count("{}") == 1 for of in lists for line in of["calls"])


def test_a_wrapped_command_keeps_its_label_and_its_words() -> None:
    for way in WAYS:
        for row, gold in zip(wrapped(GOLD, "develop", way, lambda text: "en"), GOLD, strict=True):
            assert gold["text"].strip() in row["text"]
            assert {**row, "text": ""} == {**gold, "text": ""}


def test_the_same_talk_goes_with_the_same_command() -> None:
    assert wrapped(GOLD, "measure", "around", str) == wrapped(GOLD, "measure", "around", str)


def test_talk_is_in_the_language_of_the_command_or_english() -> None:
    one = [{"text": "Fahr schneller"}]
    assert wrapped(one, "develop", "before", lambda text: "de")[0]["text"].startswith("Meine Schwester")
    assert wrapped(one, "develop", "before", lambda text: "other")[0]["text"].startswith("My sister")
