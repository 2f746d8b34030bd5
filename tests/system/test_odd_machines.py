"""Odd but legal machines: the car drives on each of them, or one line says what is missing."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from schemas.runtime.process import CONFIG, OK
from tests.running import ROOT

pytestmark = [pytest.mark.realtime, pytest.mark.thorough, pytest.mark.slow, pytest.mark.timeout(170)]
WORDS = (
    "run", "--scenario", "highway", "--seed", "3", "--port", "0", "--without", "llm", "--no-cockpit", "--duration", "2",
    "--say", "bitte schneller, über 100!", "--say-at", "0", "--json",
)  # fmt: skip
NOBODY = "http://127.0.0.1:9"
LONG = "a folder; with a name? " + "x" * 120
ENVIRONMENTS: dict[str, dict[str, str | None]] = {
    "proxies": {"HTTP_PROXY": NOBODY, "HTTPS_PROXY": NOBODY, "ALL_PROXY": "socks5://127.0.0.1:9", "NO_PROXY": "[::1]"},
    "locale C": {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii:strict"},
    "no such locale": {"LC_ALL": "xx_YY.UTF-8"},
    "no home": {"HOME": None, "XDG_DATA_HOME": None, "XDG_CACHE_HOME": None},
    "an odd temporary folder": {"TMPDIR": LONG},
    "no certificates": {"SSL_CERT_FILE": "/nowhere.pem", "SSL_CERT_DIR": "/nowhere"},
    "odd settings of others": {"OMP_NUM_THREADS": "no", "OTEL_EXPORTER_OTLP_ENDPOINT": "http://[", "RUST_LOG": "x=y=z"},
}
PRIVATE = ("unshare", "--mount", "--net", "--map-root-user")
"""A mount and a network namespace of its own."""


def drive(folder: Path, env: dict[str, str | None], *before: str, say: bool = True) -> subprocess.CompletedProcess[str]:
    """A run of two seconds in a folder of its own."""
    known = {**os.environ, "PYTHONPATH": str(ROOT), "FASTSLOW_DATA": str(folder / "data"), **env}
    return subprocess.run(
        [*before, sys.executable, "-m", "deploy", *WORDS],
        cwd=folder,
        env={name: value for name, value in known.items() if value is not None},
        capture_output=True,
        text=True,
        errors="replace",
        timeout=160,
    )


def drove(ended: subprocess.CompletedProcess[str]) -> bool:
    """Whether it did, answered, without a traceback and with nothing worse than it should be."""
    assert "Traceback" not in ended.stderr, ended.stderr
    assert ended.returncode == OK, ended.stderr
    summary = json.loads(ended.stdout)
    return bool(summary["answered"] > 0 and summary["collisions"] == 0)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_in_an_odd_environment_the_car_drives(name: str, tmp_path: Path) -> None:
    env = ENVIRONMENTS[name]
    if "TMPDIR" in env:
        (tmp_path / LONG).mkdir()
        env = {"TMPDIR": str(tmp_path / LONG)}
    assert drove(drive(tmp_path, env))


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity") or shutil.which("taskset") is None, reason="Linux")
def test_on_one_core_the_car_drives(tmp_path: Path) -> None:
    assert drove(drive(tmp_path, {}, "taskset", "--cpu-list", "0"))


def privately(script: str) -> tuple[str, ...]:
    """Before a command: it runs in namespaces of its own, after `script`."""
    if (
        shutil.which("unshare") is None
        or subprocess.run([*PRIVATE, "true"], capture_output=True, check=False).returncode
    ):
        pytest.skip("this machine allows no namespaces")
    return (*PRIVATE, "sh", "-c", f'{script} && exec "$@"', "sh")


def test_without_shared_memory_and_with_a_read_only_checkout_the_car_drives(tmp_path: Path) -> None:
    mounts = "mount -t tmpfs -o ro none /dev/shm", f"mount --bind {ROOT} {ROOT}", f"mount -o remount,bind,ro {ROOT}"
    assert drove(drive(tmp_path, {}, *privately(" && ".join(("ip link set lo up", *mounts)))))


def test_where_there_is_no_ipv4_one_line_says_so(tmp_path: Path) -> None:
    script = "ip link set lo up && ip address del 127.0.0.1/8 dev lo"
    ended = drive(tmp_path, {}, *privately(script))
    assert ended.returncode == CONFIG, ended.stderr
    assert "127.0.0.1" in ended.stderr
    assert "Traceback" not in ended.stderr
