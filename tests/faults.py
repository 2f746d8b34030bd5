"""`make faults`: causes the faults of `faults.toml`, one after the other, and writes `reports/faults.md` and `.json`,
and the table in ARCHITECTURE.md.

A row passes where all its tests do. What a test has measured it says by `record_property("measured", ...)`.
"""

from __future__ import annotations

import json
import sys
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "tests/faults.toml"
REPORT = ROOT / "reports/faults.md"
ARCHITECTURE = ROOT / "ARCHITECTURE.md"
HEAD = "| what fails | what the car does | who mends it |\n| --- | --- | --- |\n"
"""Of the table there, which ends with a blank line."""


def rows() -> list[dict[str, Any]]:
    """The table as it is written."""
    table: list[dict[str, Any]] = tomllib.loads(TABLE.read_text())["rows"]
    return table


class Outcomes:
    """A pytest plugin that keeps what became of every test, and what it measured."""

    def __init__(self) -> None:
        self.of: dict[str, str] = {}
        self.measured: dict[str, str] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" or report.outcome != "passed":
            self.of[report.nodeid] = report.outcome
            said = dict(report.user_properties)
            if "measured" in said:
                self.measured[report.nodeid] = str(said["measured"])


def belongs(test: str, wanted: str) -> bool:
    """Whether a test that has run is one of `wanted`: a file, a function with all its parameters, or one of these."""
    return test == wanted or test.startswith((f"{wanted}::", f"{wanted}["))


def judged(row: dict[str, Any], outcomes: Outcomes) -> dict[str, Any]:
    """The row with what was measured and the verdict."""
    run = [test for test in outcomes.of if any(belongs(test, wanted) for wanted in row["tests"])]
    missing = [wanted for wanted in row["tests"] if not any(belongs(test, wanted) for test in run)]
    counts = Counter(outcomes.of[test] for test in run)
    said = [outcomes.measured[test] for test in run if test in outcomes.measured]
    measured = "; ".join([f"{counts['passed']} of {len(run)} tests passed", *said, *(f"not run: {m}" for m in missing)])
    return {
        "row": row["row"],
        "fault": row["fault"],
        "tries": len(run),
        "required": row["required"],
        "measured": measured,
        "verdict": "pass" if run and not missing and set(counts) == {"passed"} else "fail",
    }


def failures(page: str) -> str:
    """ARCHITECTURE.md with its table of what fails as `faults.toml` has it."""
    before, head, rest = page.partition(HEAD)
    _, blank, after = rest.partition("\n\n")
    lines = [f"| {row['part']} | {row['ego']} | {row['mends']} |" for row in rows() if "part" in row]
    return before + head + "\n".join(lines) + blank + after


def main() -> int:
    outcomes, table = Outcomes(), rows()
    tests = list(dict.fromkeys(test for row in table for test in row["tests"]))
    pytest.main(["-q", "-p", "no:cacheprovider", "--realtime=too", *sys.argv[1:], *tests], plugins=[outcomes])
    result = [judged(row, outcomes) for row in table]
    REPORT.with_suffix(".json").write_text(json.dumps({"rows": result}, indent=1) + "\n")
    lines = ["# Faults that were caused, and what happened", "", "`make faults` writes this page.", ""]
    lines += ["| row | fault | required | tries | measured | verdict |", "| --- | --- | --- | --- | --- | --- |"]
    lines += [
        f"| {r['row']} | {r['fault']} | {r['required']} | {r['tries']} | {r['measured']} | {r['verdict']} |"
        for r in result
    ]
    REPORT.write_text("\n".join(lines) + "\n")
    ARCHITECTURE.write_text(failures(ARCHITECTURE.read_text()))
    passed = sum(r["verdict"] == "pass" for r in result)
    print(f"{passed} of {len(result)} rows pass: {REPORT.relative_to(ROOT)}")
    return 0 if passed == len(result) else 1


if __name__ == "__main__":
    sys.exit(main())
