"""The main job, with the real processes: simulator, fast node, slow node, embedded model, supervisor, zenoh."""

from __future__ import annotations

import json
import os
import signal
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from slow_node.config import THOUGHTS
from tests.running import HURRY, child_of, start
from tests.scripted import SECRET, model_of
from tests.waiting import until

pytestmark = pytest.mark.realtime


def heard(folder: Path) -> bool:
    """Whether the slow node of the run in `folder` has said that it thinks about a command."""
    return any('"heard"' in log.read_text() for log in folder.glob("runs/*/slow.jsonl"))


def hurried(prompt: str) -> str:
    """What the scripted endpoint makes of anything: an overtake."""
    return json.dumps({"reasoning": "in a hurry", "outcome": "directive", "speed": "faster", "overtake": True})


MODELS = ("embedded", "endpoint")


@dataclass(frozen=True)
class Ride:
    """A run that is over."""

    code: int
    summary: dict[str, Any]
    folder: Path


@pytest.fixture(scope="module")
def rides(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Ride]:
    """The paper's case study with either model, both at the same time: they mostly wait."""
    told = ("--scenario", "two-way-case", "--duration", "28", "--say", HURRY, "--say-at", "0.6")
    folders = {kind: tmp_path_factory.mktemp(kind) for kind in MODELS}
    with ExitStack() as stack:
        running = {}
        for kind, folder in folders.items():
            running[kind] = start(folder, *told, **stack.enter_context(model_of(kind, hurried)))
            stack.callback(running[kind].kill)
        said = {kind: run.communicate(timeout=110)[0] for kind, run in running.items()}
    return {kind: Ride(run.returncode, json.loads(said[kind]), folders[kind]) for kind, run in running.items()}


@pytest.mark.timeout(150)
@pytest.mark.parametrize("kind", MODELS)
def test_a_passenger_in_a_hurry_is_taken_past_the_slow_car_as_in_the_papers_case_study(kind, rides):
    summary, folder = rides[kind].summary, rides[kind].folder
    command = summary["commands"][0]
    assert rides[kind].code == 0
    assert (summary["collisions"], command["outcome"]) == (0, "fulfilled")
    assert command["heard_s"] <= command["issued_s"] <= command["fulfilled_s"]
    assert [lane["lane"] for lane in summary["lanes"] if lane["there"]] == [1, 0, 1]
    assert any(e["reason"] == "rear gap in lane" for e in summary["events"] if e["kind"] == "delayed")
    kept = [file.read_bytes() for file in folder.rglob("*") if file.is_file()]
    assert not any(SECRET.encode() in file for file in kept)
    assert HURRY in next(folder.glob(f"runs/*/{THOUGHTS}")).read_text("utf-8")


@pytest.mark.timeout(120)
def test_killing_the_slow_side_in_mid_thought_costs_no_tick_and_it_comes_back(tmp_path):
    running = start(tmp_path, "--duration", "14", "--say", "please overtake the car ahead", "--say-at", "1")
    until(lambda: heard(tmp_path), "the command was not heard")
    for victim in ("slow_node", "slow_node.llm.embedded"):
        slow = child_of(running.pid, victim)
        os.kill(slow, signal.SIGKILL)
        until(lambda: child_of(running.pid, victim) not in (0, slow), f"{victim} did not come back")  # noqa: B023
    out, _ = running.communicate(timeout=90)
    summary = json.loads(out)
    assert summary["restarts"] == 2
    assert summary["ticks"] - summary["answered"] <= 1
