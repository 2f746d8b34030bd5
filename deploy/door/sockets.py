"""The sockets of this process that zenoh keeps, which it would close in a way that stands still for 10 s."""

from __future__ import annotations

import os
import resource
import socket
import stat
import struct
from contextlib import suppress
from pathlib import Path

_NOT_LINGERING = struct.pack("ii", 0, 0)
_FDS = Path("/proc/self/fd")


def do_not_linger() -> int:
    """Have every TCP socket of this process close at once; returns how many there are (Linux; elsewhere: 0).

    zenoh has its sockets wait up to 10 s, when they are closed, for a reader to take what was sent. With a reader that
    stands still, one of its threads stands as long: a few of them, and nobody is served.
    """
    done = 0
    with suppress(OSError):
        for name in os.listdir(_FDS):
            with suppress(OSError):
                if stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                    done += _closes_at_once(os.dup(int(name)))
    return done


def _closes_at_once(fd: int) -> bool:
    """Whether that is a TCP socket, which it then does; `fd` is closed. Raises OSError where it is none any more."""
    try:
        copy = socket.socket(fileno=fd)
    except OSError:  # another thread has closed it meanwhile, and opened something else under its number
        os.close(fd)
        raise
    with copy:
        if copy.family not in (socket.AF_INET, socket.AF_INET6):
            return False
        copy.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NOT_LINGERING)
        return True


def allow_many() -> None:
    """As many open sockets as the system grants."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
