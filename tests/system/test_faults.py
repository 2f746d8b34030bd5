"""Faults that are caused for real while the car drives: the rows of `tests/faults.toml` that need the whole system."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from schemas.wire import topics
from schemas.wire.codec import encode
from schemas.wire.messages import Action, Directive, MetaAction
from tests.driving import driving
from tests.running import child_of
from tests.waiting import until

pytestmark = [pytest.mark.realtime, pytest.mark.slow, pytest.mark.timeout(120)]
Record = Callable[[str, object], None]

TIRING = """
import time
import numpy as np

class Tiring:
    asked = 0

    def logits(self, x):
        self.asked += 1
        if self.asked > 30:
            time.sleep(0.2)
        return np.zeros((*x.shape[:-2], 5), np.float32)

load = Tiring
"""


def alive(process: psutil.Process) -> bool:
    """Whether it does anything: one that nobody has buried yet does not."""
    try:
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    except psutil.Error:
        return False


@pytest.mark.parametrize(
    ("victim", "number"), [("fast_node", signal.SIGKILL), ("fast_node", signal.SIGSTOP), ("sim_node", signal.SIGKILL)]
)
def test_a_node_that_is_killed_or_hangs_comes_back_and_the_car_hits_nobody(
    victim: str, number: int, tmp_path: Path, record_property: Record
) -> None:
    with driving(tmp_path) as drive:
        until(drive.applies_actions, "the fast node does not drive")
        epoch, pid = drive.newest.epoch, child_of(drive.process.pid, victim)
        hit_s = time.monotonic()
        os.kill(pid, number)
        until(lambda: child_of(drive.process.pid, victim) not in (0, pid), f"{victim} did not come back")
        until(lambda: victim == "fast_node" or drive.newest.epoch > epoch, "no new world")
        until(drive.applies_actions, "it does not drive again")
        back_s, new_world = time.monotonic() - hit_s, drive.newest.epoch > epoch
        summary = drive.end()
    record_property("measured", f"drives again after {back_s:.1f} s, {summary['failsafes']} fail-safe ticks")
    assert (summary["collisions"], summary["restarts"]) == (0, 1)
    assert summary["failsafes"] > 0 or victim == "sim_node"
    assert new_world == (victim == "sim_node")


def test_a_user_who_forges_whatever_there_is_neither_drives_the_car_nor_stops_it_nor_comes_through(
    tmp_path: Path, record_property: Record
) -> None:
    with driving(tmp_path) as drive:
        until(drive.applies_actions, "the fast node does not drive")
        first, pid = drive.newest, child_of(drive.process.pid, "fast_node")
        bad = Directive(
            epoch=first.epoch, stamp_ns=0, id=1, command_id=1, scene_tick=0, target_speed_mps=math.nan, ttl_s=math.inf
        )
        future = Directive(epoch=first.epoch, stamp_ns=0, id=2**63 - 1, command_id=1, scene_tick=0, target_lane=0)
        tick = first.tick
        while drive.newest.tick < first.tick + 60:
            if drive.newest.tick == tick:
                time.sleep(0.001)
                continue
            tick, epoch = drive.newest.tick, drive.newest.epoch
            for stray in (epoch - 1, epoch, epoch + 1):
                answer = Action(
                    epoch=stray, stamp_ns=0, answers_tick=tick, meta_action=int(MetaAction.LEFT), source="policy"
                )
                drive.bus.publish(topics.ACTION, answer)
            drive.bus.publish(topics.DIRECTIVE, future)
            for topic in topics.TOPICS:
                drive.bus.publish_bytes(topic, os.urandom(200))
            drive.bus.publish_bytes(topics.DIRECTIVE, encode(bad))
            drive.bus.publish_bytes(topics.OBSERVATION, b"\xff" * 150_000)
        assert child_of(drive.process.pid, "fast_node") == pid
        summary = drive.end()
    unanswered = summary["ticks"] - summary["answered"]
    told = f"{summary['strays']} strays, {sum(summary['refused_payloads'].values())} payloads refused"
    record_property("measured", f"{unanswered} of {summary['ticks']} ticks unanswered, {told}")
    assert (summary["collisions"], summary["restarts"]) == (0, 0)
    assert unanswered <= 6
    assert summary["strays"] == 0
    assert set(summary["refused_payloads"]) <= {"command"}


def test_a_policy_that_turns_slow_is_replaced_in_time_and_the_car_counts_as_degraded(
    tmp_path: Path, record_property: Record
) -> None:
    (tmp_path / "tiring.py").write_text(TIRING)
    with driving(tmp_path, "--policy", "tiring:load") as drive:
        beats = drive.bus.subscribe(topics.STATUS)
        until(lambda: any(beat.mode == "DEGRADED" for beat in beats.take()), "it never counts as degraded")
        summary = drive.end()
    degraded = [mode for mode in summary["modes"] if mode["mode"] == "DEGRADED"]
    unanswered = summary["ticks"] - summary["answered"]
    record_property("measured", f"{unanswered} of {summary['ticks']} ticks unanswered, {len(degraded)} time DEGRADED")
    assert (len(degraded), summary["collisions"]) == (1, 0)
    assert "the policy" in degraded[0]["why"]
    assert unanswered <= 5


def test_when_the_supervisor_is_killed_nothing_is_left(tmp_path: Path, record_property: Record) -> None:
    with driving(tmp_path) as drive:
        children = psutil.Process(drive.process.pid).children(recursive=True)
        drive.process.kill()
        killed_s = time.monotonic()
        until(lambda: not any(map(alive, children)), "some live on")
        gone_s = time.monotonic() - killed_s
    record_property("measured", f"all {len(children)} processes gone after {gone_s:.1f} s")
