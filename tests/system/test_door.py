"""What users can do to a car that drives: they come through the door, however they behave."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import psutil
import pytest

from deploy.run.processes import TCP_HOST
from schemas.runtime.bus import BusConfig, BusError, open_bus
from schemas.wire import topics
from schemas.wire.messages import Observation
from tests.driving import Drive, driving
from tests.half_open import half_open
from tests.running import child_of
from tests.waiting import until

pytestmark = [pytest.mark.realtime, pytest.mark.slow, pytest.mark.timeout(300)]
Record = Callable[[str, object], None]

STANDS_STILL = """
import json, os, signal, sys, zenoh
config = zenoh.Config()
for path, value in {"mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False}.items():
    config.insert_json5(path, json.dumps(value))
session = zenoh.open(config)
everything = session.declare_subscriber("**", zenoh.handlers.RingChannel(4))
everything.handler.recv()
os.kill(os.getpid(), signal.SIGSTOP)
"""
"""A zenoh user as it comes, whose link lives for ten seconds without a sign of life."""
FLOODS = """
import json, os, sys, time, zenoh
config = zenoh.Config()
for path, value in {"mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False}.items():
    config.insert_json5(path, json.dumps(value))
keys, put, end = sys.argv[2].split(","), 0, time.monotonic() + 5.0
garbage = [os.urandom(40) for _ in range(64)]
with zenoh.open(config) as session:
    began = time.monotonic()
    while (now := time.monotonic()) < end:
        for _ in range(min(1000, int((now - began) * 5_000) - put)):
            for key in keys:
                session.put(key, garbage[put % 64])
            put += 1
        time.sleep(0.001)
print(put)
"""
TRIALS = 20
SOME = 3
"""Ticks without an answer in time that a drive on a busy machine has anyway, mostly its first ones."""


def door_of(drive: Drive) -> str:
    """Its endpoint."""
    door = psutil.Process(child_of(drive.process.pid, "deploy.door"))
    (port,) = {c.laddr.port for c in door.net_connections("tcp") if c.status == psutil.CONN_LISTEN}
    return f"tcp/{TCP_HOST}:{port}"


def watch(endpoint: str, stop: threading.Event, seen: list[Observation]) -> None:
    """Note what an honest user sees."""
    with open_bus(BusConfig(mode="client", connect=(endpoint,))) as bus:
        observations = bus.subscribe(topics.OBSERVATION)
        while not stop.wait(0.005):
            seen += observations.take()


def missed(seen: list[Observation]) -> int:
    """The most ticks in a row that are not there."""
    return max(b.tick - (a.tick if a.epoch == b.epoch else -1) - 1 for a, b in pairwise(seen))


def check(drive: Drive, record: Record, told: str) -> None:
    summary = drive.end()
    unanswered = summary["ticks"] - summary["answered"]
    record("measured", f"{told}; {unanswered} of {summary['ticks']} ticks unanswered, {summary['restarts']} restarts")
    assert (summary["restarts"], summary["collisions"], summary["strays"]) == (0, 0, 0)
    assert unanswered <= SOME + 0.01 * summary["ticks"]


def is_let_in(endpoint: str) -> bool:
    with suppress(BusError), open_bus(BusConfig(mode="client", connect=(endpoint,))) as bus:
        seen = bus.subscribe(topics.OBSERVATION)
        until(lambda: seen.take(), "nothing is to be seen")
        return True
    return False


@pytest.mark.thorough
def test_users_who_stand_still_cost_the_loop_no_tick_and_no_process_its_life(
    tmp_path: Path, record_property: Record
) -> None:
    still: list[subprocess.Popen[bytes]] = []
    stop, seen = threading.Event(), list[Observation]()
    with driving(tmp_path) as drive:
        endpoint = door_of(drive)
        watching = threading.Thread(target=watch, args=(endpoint, stop, seen))
        watching.start()
        try:
            for _ in range(TRIALS):
                still.append(subprocess.Popen([sys.executable, "-c", STANDS_STILL, endpoint]))
                time.sleep(0.5)
            until(lambda: all(psutil.Process(p.pid).status() == psutil.STATUS_STOPPED for p in still))
            first = drive.newest.tick
            until(lambda: drive.newest.tick > first + 15 * 25, "the world stands still")  # each link has ended by then
        finally:
            stop.set()
            watching.join()
            for process in still:
                process.send_signal(signal.SIGKILL)
                process.wait()
        most = missed([*seen, drive.newest])
        check(drive, record_property, f"{TRIALS} stood still; another user missed at most {most} ticks in a row")
    assert most < 75  # one socket that lingers takes 150


@pytest.mark.thorough
def test_a_flood_and_messages_of_any_length_cost_the_loop_nothing(tmp_path: Path, record_property: Record) -> None:
    with driving(tmp_path) as drive:
        endpoint = door_of(drive)
        keys = ",".join(topic.key for topic in topics.TOPICS)
        two = [subprocess.Popen([sys.executable, "-c", FLOODS, endpoint, keys], stdout=subprocess.PIPE) for _ in "ab"]
        put = sum(int(flood.communicate(timeout=100)[0]) for flood in two)
        with open_bus(BusConfig(mode="client", connect=(endpoint,))) as bus:
            for size in (4_000, 100_000, 1_000_000, 10_000_000):
                for topic in topics.TOPICS:
                    bus.publish_bytes(topic, b"x" * size)
        until(lambda: is_let_in(endpoint), "nobody is let in any more")
        each = f"{put / 5.0:.0f} messages of garbage a second on each of {len(topics.TOPICS)} keys"
        check(drive, record_property, f"{each}, and 40 of up to 10 MB")


@pytest.mark.thorough
def test_half_open_connections_cost_the_loop_nothing(tmp_path: Path, record_property: Record) -> None:
    with driving(tmp_path) as drive:
        endpoint = door_of(drive)
        port, began = int(endpoint.rpartition(":")[2]), drive.newest.tick
        with half_open(port):
            until(lambda: drive.newest.tick > began + 45, "the world stands still")
        until(lambda: is_let_in(endpoint), "nobody is let in any more")
        check(drive, record_property, "3000 half-open connections")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_door_comes_back_at_its_port_and_the_car_drives_on(
    number: int, tmp_path: Path, record_property: Record
) -> None:
    with driving(tmp_path) as drive:
        pid = child_of(drive.process.pid, "deploy.door")
        endpoint = door_of(drive)
        hit_s = time.monotonic()
        os.kill(pid, number)
        until(lambda: child_of(drive.process.pid, "deploy.door") not in (0, pid), "the door did not come back")
        until(lambda: is_let_in(endpoint), "nobody is let in any more")
        back_s = time.monotonic() - hit_s
        summary = drive.end()
    unanswered = summary["ticks"] - summary["answered"]
    record_property("measured", f"back after {back_s:.1f} s; {unanswered} of {summary['ticks']} ticks unanswered")
    assert (summary["restarts"], summary["collisions"]) == (1, 0)
    assert unanswered <= SOME + 0.01 * summary["ticks"]


def test_a_command_of_plain_text_counts_as_no_refused_payload(tmp_path: Path) -> None:
    with driving(tmp_path) as drive:
        drive.bus.publish_bytes(topics.COMMAND, b"please slow down")
        begun = drive.newest.tick
        until(lambda: drive.newest.tick > begun + 15, "nothing drives")
        summary = drive.end()
    assert summary["refused_payloads"] == {}
