"""The launcher of processes."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import psutil
import pytest

from deploy.run.launch import KEY, answers, children, environment, launch, python_module
from deploy.run.processes import free_port
from slow_node.config import TOKEN

ROOT = Path(__file__).parents[3]
STUBBORN = (
    "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\nprint('deaf', flush=True)\ntime.sleep(60)"
)
WITH_CHILD = "import subprocess, sys\nprint(subprocess.Popen(['sleep', '60']).pid, flush=True)\nsys.exit(3)"


def python(code: str) -> tuple[str, ...]:
    return sys.executable, "-c", code


def written(log: Path) -> str:
    """The first line that a process writes, whole."""
    while not (text := log.read_text()).endswith("\n"):
        os.sched_yield()
    return text


def test_a_process_runs_the_source_of_its_launcher(tmp_path: Path) -> None:
    process = launch("child", python("import deploy\nprint(deploy.__file__)"), tmp_path / "log")
    assert process.popen.wait(30) == 0
    assert written(tmp_path / "log").strip() == str(ROOT / "deploy" / "__init__.py")


def test_a_program_of_ours_imports_nothing_from_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("schemas", "deploy", "fast_node"):
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('this is not ours')\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    launch("fast", python_module("fast_node", {"policy": 1}), tmp_path / "log").popen.wait(30)
    assert "Expected `str`, got `int` - at `$.policy`" in written(tmp_path / "log")


def test_what_a_process_has_started_ends_with_it(tmp_path: Path) -> None:
    with children() as start:
        parent = start("parent", python(WITH_CHILD), tmp_path / "log")
        child = psutil.Process(int(written(tmp_path / "log")))
        assert parent.popen.wait(30) == 3
        assert parent.trouble() == f"its parent ended with code 3: {child.pid}"
        assert child.is_running()
    while child.is_running() and child.status() != psutil.STATUS_ZOMBIE:  # the kernel ends a group in its own time
        os.sched_yield()


def test_who_ignores_the_request_to_end_is_killed_after_the_grace(tmp_path: Path) -> None:
    process = launch("child", python(STUBBORN), tmp_path / "log")
    assert written(tmp_path / "log") == "deaf\n"
    process.end(grace_s=0.1)
    assert process.exit_code() == -signal.SIGKILL


def test_a_log_goes_on_where_it_ended_or_begins_anew(tmp_path: Path) -> None:
    for word, append in (("one", False), ("two", True), ("three", True)):
        launch("child", python(f"print('{word}')"), tmp_path / "log", append=append).popen.wait(30)
    assert (tmp_path / "log").read_text() == "one\ntwo\nthree\n"
    launch("child", python("print('four')"), tmp_path / "log").popen.wait(30)
    assert (tmp_path / "log").read_text() == "four\n"


def test_a_user_may_choose_the_number_of_blas_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    assert environment()["OPENBLAS_NUM_THREADS"] == "1"
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    assert environment()["OPENBLAS_NUM_THREADS"] == "2"


def test_nobody_answers_on_a_free_port() -> None:
    assert not answers(f"http://127.0.0.1:{free_port()}/health")


def test_no_process_outlives_its_block(tmp_path: Path) -> None:
    with children() as start:
        stubborn = start("child", (sys.executable, "-c", "import time; time.sleep(60)"), tmp_path / "log")
    assert stubborn.trouble() == "its child was killed by signal 15"


def test_a_program_gets_only_the_secrets_that_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KEY, "mine")
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_HEADERS", "authorization=mine")
    monkeypatch.setenv(TOKEN, "mine")
    assert "mine" not in repr(environment())
    assert environment(KEY)[KEY] == "mine"
    assert TOKEN not in environment(KEY)
    assert environment(TOKEN)[TOKEN] == environment(TOKEN)[TOKEN] not in ("", "mine", *os.environ.values())
