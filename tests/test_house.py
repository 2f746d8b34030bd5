"""What the house's numbers count."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.house import BARE, bodies, duplicates, in_circles, sources_in


def test_modules_that_import_each_other_round_about_are_in_a_circle_even_by_lazy_imports() -> None:
    sources = {
        "a/__init__.py": "",
        "a/one.py": "from a import two\n",
        "a/two.py": "def lazy():\n    from a.three import thing\n",
        "a/three.py": "import a.one\nimport os\n",
        "a/four.py": "import a.one\n",
    }
    assert in_circles(sources) == ["a.one", "a.three", "a.two"]
    assert in_circles({**sources, "a/three.py": "import os\n"}) == []


def test_a_body_has_neither_signature_nor_docstring() -> None:
    source = 'def f(\n    a,\n    b,\n):\n    """Says\n    much."""\n    a = b\n    return a\n'
    assert list(bodies(source)) == [(2, "f")]


def test_a_block_of_eight_lines_counts_once_however_often_it_is_there() -> None:
    block = "\n".join(f"x{k} = {k}" for k in range(8))
    assert duplicates({"a.py": f"{block}\n", "b.py": f"# more\nimport os\n{block}\ny = 1\n", "c.py": block}) == 1
    assert duplicates({"a.py": block, "b.py": block.replace("x3", "y3")}) == 0


@pytest.mark.parametrize(
    ("code", "bare"),
    [
        ("row[8]", True),
        ("rows[i][3]", True),
        ("lanes[aim][7]", True),
        ("rows[..., 2]", True),
        ("row[LANE]", False),
        ("rows[0][X]", False),
        ("spawn.lane[1]", False),
        ("words[3]", False),
    ],
)
def test_a_column_is_bare_where_its_number_stands_for_its_name(code: str, bare: bool) -> None:
    assert bool(BARE.search(code)) == bare


@pytest.fixture(scope="module")
def ours() -> dict[str, str]:
    return sources_in(Path(__file__).parents[1])


def test_no_modules_of_ours_import_each_other_round_about(ours: dict[str, str]) -> None:
    assert in_circles(ours) == []


def test_no_column_of_ours_is_bare(ours: dict[str, str]) -> None:
    assert [path for path, source in ours.items() if BARE.search(source)] == []


def test_no_block_of_ours_is_there_twice(ours: dict[str, str]) -> None:
    assert duplicates(ours) == 0
