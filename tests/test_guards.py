"""The guards of the other tests."""

from __future__ import annotations

import asyncio
import re
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests import guards

ROOT = Path(__file__).parents[1]


@pytest.fixture(autouse=True)
def _refused() -> Iterator[None]:
    """What is refused here is meant to be."""
    yield
    guards.broken.clear()


def connected(host: str, family: int = socket.AF_INET) -> None:
    with socket.socket(family) as one:
        one.connect((host, 80))


@pytest.mark.parametrize(
    ("reach", "host"),
    [
        (lambda: connected("192.0.2.7"), "192.0.2.7"),
        (lambda: connected("2001:db8::7", socket.AF_INET6), "2001:db8::7"),
        (lambda: socket.create_connection(("example.org", 80)), "example.org"),
        (lambda: urllib.request.urlopen("http://example.org"), "example.org"),
        (lambda: socket.gethostbyname("example.org"), "example.org"),
        (lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"x", ("192.0.2.7", 9)), "192.0.2.7"),
        (lambda: asyncio.run(asyncio.open_connection("192.0.2.7", 80)), "192.0.2.7"),
    ],
)
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_another_machine_is_refused_by_its_address(reach: Callable[[], object], host: str) -> None:
    with pytest.raises(guards.ForbiddenError, match=f"may not reach {host}"):
        reach()


def test_loopback_and_unix_sockets_are_as_ever(tmp_path: Path) -> None:
    with socket.create_server(("localhost", 0)) as server, socket.create_connection(server.getsockname()) as one:
        one.sendall(b"x")
    with socket.socket(socket.AF_UNIX) as server, socket.socket(socket.AF_UNIX) as one:
        server.bind(str(tmp_path / "s"))
        server.listen()
        one.connect(str(tmp_path / "s"))


def received(_: object) -> None:
    one, other = socket.socketpair()
    with one, other:
        one.recv(1)


@pytest.fixture
def process() -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, "-c", ""]) as one:
        yield one


@pytest.mark.parametrize(
    ("block", "what"),
    [
        (lambda _: time.sleep(0.0), "time.sleep"),
        (received, "socket.recv"),
        (lambda process: process.wait(), "waiting for a process"),
    ],
)
def test_what_blocks_an_event_loop_is_refused_in_it(
    block: Callable[[subprocess.Popen[bytes]], None], what: str, process: subprocess.Popen[bytes]
) -> None:
    async def blocking() -> None:
        block(process)

    with pytest.raises(guards.ForbiddenError, match=f"{what} blocks the event loop"):
        asyncio.run(blocking())


def test_outside_a_loop_and_in_a_thread_of_one_a_test_may_wait() -> None:
    time.sleep(0.0)
    asyncio.run(asyncio.to_thread(time.sleep, 0.0))


SWALLOWS = """
import asyncio, time

async def careless():
    try:
        time.sleep(0.0)
    except BaseException:
        pass

def test_it():
    asyncio.run(careless())
"""


def pytest_on(folder: Path, code: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Pytest, with our conftest, on one file."""
    (folder / "test_one.py").write_text(code)
    (folder / "conftest.py").write_text((ROOT / "tests/conftest.py").read_text())
    (folder / "pytest.ini").write_text(f"[pytest]\npythonpath = {ROOT}\n")
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-s", "-p", "no:cacheprovider", *options, str(folder / "test_one.py")],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_test_fails_even_where_the_code_swallows_the_refusal(tmp_path: Path) -> None:
    done = pytest_on(tmp_path, SWALLOWS)
    assert done.returncode == 1, done.stdout
    assert "time.sleep blocks the event loop" in done.stdout


DRAWS = """
from hypothesis import given, settings, strategies as st

@settings(max_examples=5)
@given(st.integers())
def test_it(number):
    print("drawn", number)
"""


def drawn(folder: Path, *options: str) -> list[str]:
    return [line for line in pytest_on(folder, DRAWS, *options).stdout.splitlines() if "drawn" in line]


def test_examples_are_the_same_every_time(tmp_path: Path) -> None:
    assert drawn(tmp_path) == drawn(tmp_path) != []


def test_a_search_draws_other_examples_each_time_and_ten_times_as_many(tmp_path: Path) -> None:
    one, two = (drawn(tmp_path, "--hypothesis-profile=search") for _ in range(2))
    assert one != two
    assert len(one) == len(two) == 10 * len(drawn(tmp_path))


def test_no_test_imports_another() -> None:
    tests = sorted((ROOT / "tests").rglob("test_*.py"))
    assert [str(one) for one in tests if re.search(r"^(from|import) .*\btest_", one.read_text(), re.M)] == []
