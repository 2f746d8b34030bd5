"""The table of faults: every row names tests that there are, and its verdict is theirs."""

from __future__ import annotations

from typing import Any

import pytest

from tests.faults import ARCHITECTURE, HEAD, ROOT, Outcomes, failures, judged, rows


@pytest.mark.parametrize("row", rows(), ids=lambda row: row["row"])
def test_every_row_names_tests_that_there_are(row: dict[str, Any]) -> None:
    assert all(row[name] for name in ("fault", "required", "tests"))
    for test in row["tests"]:
        file, _, function = test.partition("::")
        source = (ROOT / file).read_text()
        assert not function or f"def {function.partition('[')[0]}(" in source, test


def test_a_row_passes_where_all_its_tests_have_run_and_passed() -> None:
    row = {"row": "1", "fault": "f", "required": "r", "tests": ["a.py::test_x", "b.py"]}
    outcomes = Outcomes()
    outcomes.of = {"a.py::test_x[1]": "passed", "a.py::test_xy": "failed", "b.py::test_z": "passed"}
    outcomes.measured = {"b.py::test_z": "3 s"}
    assert judged(row, outcomes)["measured"] == "2 of 2 tests passed; 3 s"
    assert judged(row, outcomes)["verdict"] == "pass"
    for worse in ({"b.py::test_z": "skipped"}, {"b.py::test_z": "failed"}):
        outcomes.of |= worse
        assert judged(row, outcomes)["verdict"] == "fail"
    del outcomes.of["b.py::test_z"]
    assert judged(row, outcomes)["measured"].endswith("not run: b.py")
    assert judged(row, outcomes)["verdict"] == "fail"


def test_the_architectures_table_of_what_fails_is_made_of_these_rows() -> None:
    page = ARCHITECTURE.read_text()
    assert HEAD in page
    assert failures(page) == page
