"""What the passenger is told."""

from __future__ import annotations

from slow_node.planning.replies import SENTENCES


def test_every_sentence_is_known_in_every_language() -> None:
    languages = SENTENCES["done"].keys()
    assert all(sentences.keys() == languages for sentences in SENTENCES.values())
    assert len(languages) == 7
