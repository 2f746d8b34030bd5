"""What a long run is judged by."""

from __future__ import annotations

import json

import pytest

from tests import soak
from tests.soak_report import REPORT, page, wrong


def test_the_kept_page_is_made_of_the_kept_rows() -> None:
    assert page(json.loads(REPORT.with_suffix(".json").read_text())["rows"]) == REPORT.read_text()


def test_a_part_that_breaks_off_fails_and_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def ends(scale: float, shared: bool) -> dict[str, object]:
        raise AssertionError("the run ended with code 1")

    monkeypatch.setitem(soak.PARTS, "kills", ends)
    row = soak.driven("kills", 1.0, shared=False)
    assert wrong(row) == ["broken off: the run ended with code 1"]
    made = row | {"verdict": "fail", "wrong": wrong(row), "revision": "0", "machine": "none"}
    assert "* Wrong: broken off: the run ended with code 1" in page([made])
