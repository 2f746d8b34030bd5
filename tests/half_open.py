"""Strangers who connect and never go on."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress

from deploy.run.links import TCP_HOST


@contextmanager
def half_open(port: int, count: int = 3000) -> Iterator[None]:
    """Connections to a port of ours for the time of the block; half of them begin a message that never ends."""
    with ExitStack() as stack:
        for number in range(count):
            one = stack.enter_context(closing(socket.socket()))
            one.setblocking(False)
            one.connect_ex((TCP_HOST, port))
            if number % 2:
                with suppress(OSError):
                    one.send(b"\x05\x00")
        yield
