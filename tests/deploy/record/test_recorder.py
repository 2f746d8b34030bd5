"""The recorder as a process on a real bus: killed, on a full disk, and beside the recordings of older runs."""

from __future__ import annotations

import fcntl
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from deploy.record.__main__ import NAME
from deploy.record.reader import open_recording
from deploy.record.recorder import prune
from deploy.run.launch import temporary_folder
from deploy.run.processes import RECORDING
from schemas.runtime.bus import BusConfig, ZenohBus, open_bus
from schemas.wire.messages import Command, Event, EventKind, Status
from schemas.wire.topics import COMMAND, EVENT, STATUS
from tests.waiting import until

ROOT = Path(__file__).parents[3]


@pytest.fixture
def router() -> Iterator[tuple[ZenohBus, str]]:
    with temporary_folder() as folder:  # pytest's own are too long for a Unix socket
        endpoint = f"unixsock-stream/{folder}/bus.sock"
        with open_bus(BusConfig(mode="router", listen=(endpoint,))) as bus:
            yield bus, endpoint


@contextmanager
def recorder(endpoint: str, path: Path, most_bytes: int | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """The process; `most_bytes`: no file of its may grow beyond, as on a full disk."""
    config = {"bus": {"mode": "client", "connect": [endpoint]}, "path": str(path), "about": {"seed": "3"}}
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (most_bytes, most_bytes)) if most_bytes else None
    process = subprocess.Popen(
        [sys.executable, "-m", "deploy.record", json.dumps(config)],
        cwd=ROOT,
        stderr=subprocess.DEVNULL,
        preexec_fn=limit,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def command(number: int, text: str = "please overtake") -> Command:
    return Command(epoch=0, stamp_ns=time.monotonic_ns(), id=number, text=text)


def commands(path: Path) -> list[Command]:
    """Those in a recording."""
    if not path.exists() or not path.stat().st_size:
        return []
    return [m for _, _, m in open_recording(path).messages({"command"}) if isinstance(m, Command)]


def recorded(path: Path) -> list[int]:
    """Their numbers."""
    return [m.id for m in commands(path)]


def said(bus: ZenohBus, path: Path) -> list[int]:
    """Numbers of commands that were said until some of them were in the file."""
    numbers: list[int] = []

    def say() -> bool:
        numbers.append(len(numbers))
        bus.publish(COMMAND, command(numbers[-1]))
        time.sleep(0.02)
        return bool(recorded(path))

    until(say)
    return numbers


def test_a_killed_recorder_leaves_what_was_said_until_a_second_ago_and_its_successor_goes_on(router, tmp_path):
    bus, endpoint = router
    path = tmp_path / "a.mcap"
    with recorder(endpoint, path) as process:
        said(bus, path)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    before = recorded(path)
    assert before == list(range(before[0], before[-1] + 1))
    assert not open_recording(path).finished
    statuses = bus.subscribe(STATUS)
    with recorder(endpoint, path) as process:
        until(lambda: any(status.node == NAME for status in statuses.take()))
        bus.publish(COMMAND, command(10_000))
        bus.publish_bytes(COMMAND, b"plain text")
        until(lambda: commands(path)[-1].text == "plain text")
        process.terminate()
        assert process.wait() == 0
    after = recorded(path)
    assert after[: len(before) + 1] == [*before, 10_000]
    recording = open_recording(path)
    assert (recording.finished, recording.metadata["seed"]) == (True, "3")
    assert commands(path)[-1].text == "plain text"


def test_on_a_full_disk_the_recorder_says_so_once_and_lives_on_with_a_file_that_is_whole(router, tmp_path):
    bus, endpoint = router
    path = tmp_path / "a.mcap"
    events, statuses = bus.subscribe(EVENT), bus.subscribe(STATUS)
    faults: list[Event] = []
    beats: list[Status] = []

    def full() -> bool:
        bus.publish(COMMAND, command(1, os.urandom(200).hex()))
        time.sleep(0.002)
        faults.extend(events.take())
        return bool(faults)

    with recorder(endpoint, path, most_bytes=100_000) as process:
        until(full)
        statuses.take()

        def degraded() -> bool:
            beats.extend(statuses.take())
            return any(beat.state == "degraded" for beat in beats)

        until(degraded)
        assert process.poll() is None
    assert [event.kind for event in faults] == [EventKind.FAULT]
    assert "File too large" in faults[0].detail
    assert open_recording(path).finished
    assert recorded(path)


def test_the_oldest_recordings_make_room_and_one_that_is_being_written_is_left_alone(tmp_path):
    paths = [tmp_path / f"run{k}" / RECORDING for k in range(4)]
    for age, path in enumerate(paths):
        path.parent.mkdir()
        path.write_bytes(b"x" * 1000)
        os.utime(path, (age, age))
    (tmp_path / "run0" / "summary.json").write_text("{}")
    with paths[1].open("rb") as written:
        fcntl.flock(written, fcntl.LOCK_EX)
        assert prune(tmp_path, 2500) == [paths[0], paths[2]]
    assert (tmp_path / "run0" / "summary.json").exists()
    assert prune(tmp_path, 2500) == []
