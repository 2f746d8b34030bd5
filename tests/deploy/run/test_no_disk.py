"""A disk that takes nothing ends no drive; a run that did not drive does not end with 0."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from deploy.run.processes import Process, RunOptions
from deploy.run.system import run_system
from schemas.runtime.process import FAILED, OK

ROOT = Path(__file__).parents[3]
WORDS = ("run", "--scenario", "highway", "--port", "0", "--without", "llm", "--no-cockpit", "--duration", "2", "--json")


def drive(folder: Path, data: str, most_bytes: int) -> subprocess.CompletedProcess[str]:
    """A run whose processes can write no file beyond `most_bytes`: the kernel refuses the rest as a full disk does."""
    return subprocess.run(
        [sys.executable, "-m", "deploy", *WORDS],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "FASTSLOW_DATA": data},
        capture_output=True,
        text=True,
        timeout=100,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes)),
    )


@pytest.mark.skipif(not Path("/sys/kernel").exists(), reason="a folder in which nobody may make one: Linux")
def test_a_run_without_a_folder_to_write_into_drives_without_logs_and_recording(tmp_path: Path) -> None:
    ended = drive(Path("/sys/kernel"), str(tmp_path), 100_000_000)
    assert (ended.returncode, json.loads(ended.stdout)["ticks"] > 0) == (OK, True), ended.stderr
    assert ended.stderr.count("goes on without logs and recording") == 1


def test_a_run_on_a_full_disk_drives_without_log_bank_and_recording_and_says_so(tmp_path: Path) -> None:
    ended = drive(tmp_path, "/proc/none", 600)  # what lets the nodes in takes 300 bytes
    assert (ended.returncode, json.loads(ended.stdout)["ticks"] > 0) == (OK, True), ended.stderr
    assert ended.stderr.count("the run goes on without logs") == 1
    assert "going on without what was remembered" in ended.stderr
    assert "record cannot start" in ended.stderr


def test_a_run_that_drove_no_tick_ends_with_a_reason_and_not_with_0(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FASTSLOW_DATA", str(tmp_path))
    table = (Process(name="sim", argv=(sys.executable, "-c", ""), critical=True, finishes=True),)
    assert run_system(RunOptions(port=0), table) == FAILED
    assert "drove no tick" in capsys.readouterr().err
