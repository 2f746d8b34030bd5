"""`make soak` in short: the slow node dies as it writes, the supervisor last, and nothing is damaged or left."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.running import ROOT

pytestmark = [pytest.mark.realtime, pytest.mark.thorough, pytest.mark.slow, pytest.mark.timeout(300)]


def test_a_bank_survives_the_death_of_who_writes_into_it_and_a_killed_run_leaves_nothing(tmp_path: Path) -> None:
    report = tmp_path / "soak.md"
    words = (sys.executable, "-m", "tests.soak", "memory", "--scale", "0.01", "--report", str(report))
    ended = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=280, check=False)
    (row,) = json.loads(report.with_suffix(".json").read_text())["rows"]
    assert (ended.returncode, row["verdict"]) == (0, "pass"), ended.stderr + ended.stdout
    assert row["did"]["killed"] == row["did"]["bank_sound"] == 2
    assert set(row["left"].values()) == {0}
    assert "## memory: pass" in report.read_text()
