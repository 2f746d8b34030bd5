"""Each way to ask for what is refused is known by its own words, and by no others."""

from __future__ import annotations

import re

import pytest

from slow_node.understanding.refusals import REFUSALS, RefusedWords, unsafe
from slow_node.understanding.text import fold

EACH = pytest.mark.parametrize(
    ("group", "row"),
    [(group, row) for group, rows in REFUSALS.items() for row in rows],
    ids=lambda value: value.name if isinstance(value, RefusedWords) else value,
)


@EACH
def test_an_expression_matches_its_command_which_is_refused_and_not_the_one_beside_it(
    group: str, row: RefusedWords
) -> None:
    assert re.search(row.pattern, fold(row.matches))
    assert unsafe(row.matches)
    assert not re.search(row.pattern, fold(row.passes))


def test_a_row_has_a_name_of_its_own() -> None:
    names = [row.name for rows in REFUSALS.values() for row in rows]
    assert len(names) == len(set(names))
