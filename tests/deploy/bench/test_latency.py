"""A latency run: what it measures on the real processes, how it ends, and what the command line says."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
from typer.testing import CliRunner

from deploy.bench import latency, latency_report, latency_results, latency_samples
from deploy.cli.bench import app
from tests.waiting import PATIENCE_S, until

ROOT = Path(__file__).parents[3]


def fastslow(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{cwd}"}
    return subprocess.run(
        [sys.executable, "-m", "deploy", *arguments],
        cwd=cwd,
        env=env,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize(
    ("seconds", "loads", "each", "order"),
    [
        (900.0, "llm", 900.0, "llm"),
        (8.0, "none llm", 2.0, "none llm llm none none llm llm none"),
        (240.0, "none cpu llm", 60.0, "none cpu llm llm cpu none none cpu llm llm cpu none"),
        (360.0, "none cpu", 60.0, "none cpu cpu none none cpu cpu none none cpu cpu none"),
    ],
)
def test_loads_take_turns_for_their_time_in_all(seconds: float, loads: str, each: float, order: str) -> None:
    blocks = latency.blocks(seconds, loads.split())  # type: ignore[arg-type]
    assert blocks == [(load, each) for load in order.split()]


def test_what_is_not_installed_is_absent_and_not_included(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def measure(options: latency.Options, load: str, _: Path, samples: latency_samples.Samples) -> None:
        for what in (*options.peers, "ours"):
            samples.add((what, load, "15hz"), [1_000])

    monkeypatch.setattr(latency, "available", lambda _: ("floor",))
    monkeypatch.setattr(latency, "_paced", measure)
    monkeypatch.setattr(latency, "_back_to_back", measure)
    result, _ = latency.run(latency.Options(loads=("none",), peers=("floor", "dora"), out=tmp_path))
    assert [(row["what"], row["pace"], row["why"]) for row in result["absent"]] == [
        ("dora", pace, "not installed: pip install 'fastslow[bench]'") for pace in latency.PACES
    ]
    assert [text.partition(":")[0] for text in result["included"][:-1]] == ["ours", "floor"]


def marked(mark: str, module: str = "") -> list[int]:
    """The processes that have `mark` in their environment and `module` in their command line."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if (
                mark.encode() in (process / "environ").read_bytes()
                and module.encode() in (process / "cmdline").read_bytes()
            ):
                found.append(int(process.name))
        except OSError:  # it has ended, or is somebody else's
            continue
    return found


@contextmanager
def started(folder: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command line in the background, and the mark of its processes."""
    mark = f"FASTSLOW_TEST={uuid4()}"
    env = {**os.environ, "PYTHONPATH": str(ROOT), **dict([mark.split("=")])}
    process = subprocess.Popen(
        [sys.executable, "-m", "deploy", *arguments],
        cwd=folder,
        env=env,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        yield process, mark
    finally:
        process.kill()
        process.wait()


def wait_for(mark: str, module: str) -> int:
    return until(lambda: marked(mark, module), f"no {module} came up")[0]


FLOOR_ALONE = ("bench", "latency", "--seconds", "2", "--load", "none", "--peer", "floor", "--json")
needs_proc = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds processes in /proc")


@needs_proc
@pytest.mark.realtime
def test_without_ours_the_others_are_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FASTSLOW_TEST", mark := str(uuid4()))
    samples = latency_samples.Samples()

    def kill() -> None:
        wait_for(mark, "deploy.bench.pingpong_end")
        os.kill(wait_for(mark, "fast_node"), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    latency._paced(latency.Options(seconds=1.0, peers=("floor",)), "none", tmp_path, samples)
    killer.join()
    assert [len(took) for took in samples.took.values()] == [15]
    assert samples.absent["ours", "none", "15hz"].startswith("fast killed by signal 9")


@pytest.mark.parametrize(("absent", "code"), [("ours", 1), ("floor", 1), ("zmq", 0), ("dora", 0)])
def test_only_without_ours_or_the_floor_the_benchmark_fails(
    absent: str, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(latency, "run", lambda _: ({"rows": [], "absent": [{"what": absent}]}, Path("x")))
    assert CliRunner().invoke(app, ["latency", "--json"]).exit_code == code


@needs_proc
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.realtime
def test_a_signal_ends_the_benchmark_and_all_it_started(tmp_path: Path, number: int, code: int) -> None:
    with started(tmp_path, *FLOOR_ALONE) as (process, mark):
        wait_for(mark, "deploy.bench.pingpong_end")
        process.send_signal(number)
        _, said = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, said.splitlines()[-1], marked(mark)) == (code, "fastslow: stopped", [])


@pytest.mark.parametrize(
    "arguments",
    [("run", "--realtime", "warp"), ("bench", "latency", "--load", "gpu"), ("bench", "latency", "--peer", "carrier")],
)
def test_what_does_not_exist_is_a_usage_error(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    done = fastslow(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "choose from" in done.stderr


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """One short run on the real processes, where pyzmq is broken."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "zmq.py").write_text("raise ImportError('libzmq.so.5: no such file')\n")
    done = fastslow(
        "bench",
        "latency",
        "--seconds",
        "2",
        "--load",
        "none",
        "--peer",
        "floor",
        "--peer",
        "bus",
        "--peer",
        "bus-default",
        "--peer",
        "zmq",
        "--json",
        "--out",
        "out",
        "--plot",
        "picture.png",
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result, folder


@pytest.mark.realtime
def test_every_contender_is_measured_at_both_paces(measured: tuple[dict[str, Any], Path]) -> None:
    assert {(row["what"], row["pace"]) for row in measured[0]["rows"]} == {
        (what, pace) for what in ("floor", "bus", "bus-default", "ours") for pace in ("15hz", "back-to-back")
    }


@pytest.mark.realtime
def test_a_peer_that_cannot_start_is_absent_with_its_last_words(measured: tuple[dict[str, Any], Path]) -> None:
    words = "end ended with code 1: ImportError: libzmq.so.5: no such file"
    assert [(row["what"], row["pace"], words in row["why"]) for row in measured[0]["absent"]] == [
        ("zmq", "15hz", True),
        ("zmq", "back-to-back", True),
    ]


@pytest.mark.realtime
def test_a_row_is_what_was_promised(measured: tuple[dict[str, Any], Path]) -> None:
    assert set(measured[0]["rows"][0]) == {
        "what",
        "load",
        "pace",
        "n",
        "p50_us",
        "p90_us",
        "p99_us",
        "p999_us",
        "max_us",
        "misses",
    }


@pytest.mark.realtime
def test_the_paced_loop_is_measured_at_every_tick(measured: tuple[dict[str, Any], Path]) -> None:
    [ours] = [row for row in measured[0]["rows"] if (row["what"], row["pace"]) == ("ours", "15hz")]
    assert 29 <= ours["n"] + measured[0]["loads"]["none"]["skipped_ticks"] <= 31


@pytest.mark.realtime
def test_the_parts_of_a_tick_are_all_there(measured: tuple[dict[str, Any], Path]) -> None:
    parts = measured[0]["parts_us"]["none"]
    assert tuple(parts) == latency_samples.PARTS
    assert all(part["p50"] > 0 for name, part in parts.items() if name != "bus out")  # which may overlap the put


@pytest.mark.realtime
def test_what_is_applied_is_about_as_old_as_the_round_trip(measured: tuple[dict[str, Any], Path]) -> None:
    age, [ours] = (
        measured[0]["loads"]["none"]["applied_age_us"],
        [row for row in measured[0]["rows"] if (row["what"], row["load"], row["pace"]) == ("ours", "none", "15hz")],
    )
    assert ours["p50_us"] <= age["p50"] <= latency_results.DEADLINE_US


@pytest.mark.realtime
def test_all_say_how_late_they_were_and_how_they_are_scheduled(measured: tuple[dict[str, Any], Path]) -> None:
    paced = measured[0]["loads"]["none"]
    assert paced["timer_late_us"].keys() == {"floor", "bus", "bus-default", "ours"}
    assert paced["scheduling"].keys() == {"floor", "bus", "bus-default", "sim", "fast"}


@pytest.mark.realtime
def test_the_text_says_what_the_result_does(measured: tuple[dict[str, Any], Path]) -> None:
    result = measured[0]
    said = "\n".join(latency_report.lines(result))
    for row in result["rows"]:
        assert f"{row['load']:<7} {row['pace']:<13} {row['what']:<12} {row['n']:>7} {row['p50_us']:>8.0f}" in said
    for name, how in result["loads"]["none"]["scheduling"].items():
        assert f"{name} {how}" in said
    assert "none    15hz          zmq          absent: " in said
    assert "sent after it was due, load none, p50/p99 us: floor " in said
    assert "parts of ours, load none, p50/p99 us: sim: encode and put " in said
    assert all(target["figure"] in said for target in result["targets"])
    assert all(f"included: {text}" in said for text in result["included"])


@pytest.mark.realtime
def test_the_saved_result_can_be_compared(measured: tuple[dict[str, Any], Path]) -> None:
    saved = str(measured[1] / "out" / "latency.json")
    done = fastslow("bench", "compare", saved, saved, "--json", cwd=measured[1])
    rows = json.loads(done.stdout)["rows"]
    assert [row["p50_us"]["ratio"] for row in rows] == [1.0] * len(measured[0]["rows"]) == [1.0] * 8


@pytest.mark.realtime
def test_the_picture_is_drawn(measured: tuple[dict[str, Any], Path]) -> None:
    assert (measured[1] / "picture.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
@pytest.mark.realtime
def test_with_cockpit_and_recorder_the_page_gets_frames_and_messages_are_recorded(tmp_path: Path) -> None:
    command = ("bench", "latency", "--seconds", "4", "--load", "watched", "--peer", "none", "--json", "--out", "out")
    done = fastslow(*command, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert {(row["what"], row["load"], row["pace"]) for row in result["rows"]} == {("ours", "watched", "15hz")}
    assert min(result["loads"]["watched"]["load"][name] for name in ("frames", "messages recorded")) > 0
    assert (tmp_path / "out" / "recording.mcap").stat().st_size > 0
