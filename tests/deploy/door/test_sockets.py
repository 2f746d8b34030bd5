"""The door's sockets close at once, and looking for them leaves nothing open."""

from __future__ import annotations

import os
import socket
import stat
import struct
import sys

import pytest

from deploy.door.sockets import do_not_linger

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def test_tcp_sockets_of_this_process_do_not_linger() -> None:
    with socket.socket() as one, socket.socket(socket.AF_UNIX) as other:
        for each in (one, other):
            each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
        assert do_not_linger() >= 1
        still = [each.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8)[0] for each in (one, other)]
    assert still == [0, 1]


def test_what_is_no_socket_any_more_is_not_left_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stat, "S_ISSOCK", lambda mode: True)  # as if each had been one a moment ago
    read, write = os.pipe()
    try:
        before = len(os.listdir("/proc/self/fd"))
        do_not_linger()
        assert len(os.listdir("/proc/self/fd")) == before
    finally:
        os.close(read)
        os.close(write)
