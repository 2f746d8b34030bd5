"""Nothing of a run grows without bound, and nothing of it is left when it is gone, however it has ended."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from deploy.run.launch import temporary_folder
from deploy.run.logs import SUMMARY, SUPERVISOR, open_log, prune, rotate
from deploy.run.processes import RECORDING
from deploy.run.summary import KEPT, Summary
from schemas.runtime.errors import ConfigError
from schemas.wire.messages import Command, Reply, Status
from slow_node.config import THOUGHTS, WISHES
from tests.waiting import until

ROOT = Path(__file__).parents[3]


def test_a_log_that_is_too_long_is_kept_as_the_old_one_and_goes_on_empty(tmp_path: Path) -> None:
    log = tmp_path / "sim.jsonl"
    with log.open("ab", buffering=0) as written:
        written.write(b"x" * 101)
        rotate(tmp_path, 100)
        written.write(b"after")
        rotate(tmp_path, 100)
    assert log.read_bytes() == b"after"
    assert (tmp_path / "sim.old.jsonl").read_bytes() == b"x" * 101


def test_thoughts_and_old_logs_are_not_cut(tmp_path: Path) -> None:
    for name in ("thoughts.jsonl", "slow.old.jsonl"):
        (tmp_path / name).write_bytes(b"x" * 101)
    rotate(tmp_path, 100)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["slow.old.jsonl", "thoughts.jsonl"]
    assert (tmp_path / "thoughts.jsonl").stat().st_size == 101


def test_the_logs_of_the_oldest_runs_go_but_no_recording_no_file_of_others_and_no_run_that_is_going_on(
    tmp_path: Path,
) -> None:
    first, recorded, noted, going_on, newest = (tmp_path / f"2026112{k}T120000Z-{9 - k}" for k in range(5))
    others = tmp_path / "bench-20261101T120000Z-1"
    for folder in (first, recorded, noted, going_on, newest, others):
        folder.mkdir()
        for name in (SUPERVISOR, "sim.jsonl", THOUGHTS, "thoughts.old.jsonl", WISHES, SUMMARY):
            (folder / name).write_bytes(b"x" * 100)
    (recorded / RECORDING).write_bytes(b"x" * 1000)
    (noted / "notes.txt").write_text("mine")
    with open_log(going_on):
        assert prune(tmp_path, 3000) == []
        assert prune(tmp_path, 2999) == [first]
        assert not first.exists()
        assert prune(tmp_path, 1200) == [recorded, noted]
        assert [path.name for folder in (recorded, noted) for path in folder.iterdir()] == [RECORDING, "notes.txt"]
        assert prune(tmp_path, 600) == [newest]
        assert (len([*going_on.iterdir()]), len([*others.iterdir()])) == (6, 6)
    assert prune(tmp_path, 0) == [going_on]


def test_a_flood_of_commands_replies_and_forged_heartbeats_fills_no_summary() -> None:
    summary = Summary("highway", 0, 0)
    for k in range(3 * KEPT):
        summary.command(Command(epoch=0, stamp_ns=k, id=k, text="x", source="x"))
        summary.reply(Reply(epoch=0, stamp_ns=k, command_id=-k, text="x", outcome="heard"))
        summary.status(Status(epoch=0, stamp_ns=k, node="sim", pid=k, seq=k, state="ready", metrics={"ticks": 1.0}))
    told = summary.result({}, 0)
    assert (len(told["commands"]), told["ticks"]) == (KEPT, KEPT)  # type: ignore[arg-type]


def test_a_command_that_was_kept_hears_its_outcome_in_a_flood() -> None:
    summary = Summary("highway", 0, 0)
    for k in range(2 * KEPT):
        summary.command(Command(epoch=0, stamp_ns=k, id=k, text="x", source="x"))
    summary.reply(Reply(epoch=0, stamp_ns=1, command_id=0, text="x", outcome="fulfilled"))
    assert summary.result({}, 0)["commands"][0]["outcome"] == "fulfilled"  # type: ignore[index]


def test_a_temporary_folder_goes_with_its_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", "/tmp")
    with temporary_folder("fastslow-test-") as folder:
        (folder / "bus.sock").touch()
    assert not folder.exists()


def test_a_temporary_folder_goes_with_a_process_that_is_killed(tmp_path: Path) -> None:
    code = (
        "import os, sys\nfrom deploy.run.launch import temporary_folder\n"
        "with temporary_folder('fastslow-test-') as folder:\n"
        "    (folder / 'bus.sock').touch()\n    print(folder, flush=True)\n    sys.stdin.read()"
    )
    env = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": "/tmp"}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env
    ) as process:
        assert process.stdout is not None
        folder = Path(process.stdout.readline().strip())
        assert (folder / "bus.sock").exists()
        process.kill()
        until(lambda: not folder.exists(), "the folder is left")


@pytest.mark.parametrize("odd", ["/tmp/no such folder", "/" + 100 * "x", "/proc", "/tmp/a;b?c", ""])
def test_where_no_socket_can_be_the_machine_s_own_temporary_folder_is_used(
    odd: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", odd)
    with temporary_folder("fastslow-test-") as folder:
        assert folder.parent in (Path("/tmp"), Path("/var/tmp"))


def test_without_any_temporary_folder_one_line_says_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(**_: object) -> str:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("deploy.run.launch.tempfile.mkdtemp", none)
    with pytest.raises(ConfigError, match="set TMPDIR"), temporary_folder():
        pass
