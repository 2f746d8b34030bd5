"""What no test may do: reach beyond this machine, or block an event loop. `conftest.py` sets these guards.

They hold in the process of the tests. What breaks one gets an error at once, and its test fails even if the code under
test swallows that error.
"""

from __future__ import annotations

import asyncio
import functools
import ipaddress
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import pytest

broken: list[str] = []
"""What was refused during this test."""
WAITS = ("accept", "recv", "recv_into", "recvfrom", "recvfrom_into", "send", "sendall")
"""What a socket in blocking mode may wait in; so may connecting."""


class ForbiddenError(AssertionError):
    """A test may not do this."""


def refuse(what: str) -> NoReturn:
    broken.append(what)
    raise ForbiddenError(what)


def is_here(host: object) -> bool:
    """Whether a host is this machine: loopback, or nothing at all."""
    text = host.decode() if isinstance(host, bytes) else host
    if text in (None, "", "localhost"):
        return True
    try:
        address = ipaddress.ip_address(str(text).partition("%")[0])
    except ValueError:
        return False
    return address.is_loopback or address.is_unspecified


def in_a_loop() -> bool:
    """Whether this thread is running an event loop."""
    return asyncio._get_running_loop() is not None


def without_blocking(does: Callable[..., Any], what: str) -> Callable[..., Any]:
    """The same function, refused inside a running event loop."""

    @functools.wraps(does)
    def guarded(*given: Any, **named: Any) -> Any:
        if in_a_loop():
            refuse(f"{what} blocks the event loop: await something instead, or use asyncio.to_thread")
        return does(*given, **named)

    return guarded


def only_here(does: Callable[..., Any], host_of: Callable[..., object]) -> Callable[..., Any]:
    """The same function, refused for the address of another machine."""

    @functools.wraps(does)
    def guarded(*given: Any, **named: Any) -> Any:
        host = host_of(*given, **named)
        if not is_here(host):
            refuse(f"a test may not reach {host}: only loopback and Unix sockets")
        return does(*given, **named)

    return guarded


def of_socket(wait: Callable[..., Any], name: str) -> Callable[..., Any]:
    """The same method of a socket, refused where it would wait inside a running event loop."""

    @functools.wraps(wait)
    def guarded(self: socket.socket, *given: Any, **named: Any) -> Any:
        if self.gettimeout() != 0.0 and in_a_loop():
            refuse(f"socket.{name} blocks the event loop: use the loop's streams, or asyncio.to_thread")
        return wait(self, *given, **named)

    return guarded


def host_connected(self: socket.socket, address: Any) -> object:
    return address[0] if self.family in (socket.AF_INET, socket.AF_INET6) else None


def host_sent_to(self: socket.socket, *given: Any) -> object:
    return host_connected(self, given[-1])


@contextmanager
def guarded() -> Iterator[None]:
    """No network but this machine's own, and no blocking of an event loop, for the time of the block."""
    with pytest.MonkeyPatch.context() as patch:
        for name in WAITS:
            patch.setattr(socket.socket, name, of_socket(getattr(socket.socket, name), name))
        for name in ("connect", "connect_ex"):
            connect = of_socket(getattr(socket.socket, name), name)
            patch.setattr(socket.socket, name, only_here(connect, host_connected))
        patch.setattr(socket.socket, "sendto", only_here(socket.socket.sendto, host_sent_to))
        patch.setattr(socket, "getaddrinfo", only_here(socket.getaddrinfo, lambda host, *_, **__: host))
        patch.setattr(socket, "gethostbyname", only_here(socket.gethostbyname, lambda host: host))
        patch.setattr(time, "sleep", without_blocking(time.sleep, "time.sleep"))
        patch.setattr(subprocess.Popen, "wait", without_blocking(subprocess.Popen.wait, "waiting for a process"))
        yield
