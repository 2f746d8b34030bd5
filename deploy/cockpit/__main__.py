"""`python -m deploy.cockpit '{"bus": {...}}'`: serve the page of a running car until a signal."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import uvicorn

from deploy.cockpit.config import CockpitConfig
from deploy.cockpit.hub import Hub
from deploy.cockpit.server import MAX_IN_BYTES, application
from deploy.cockpit.sources import BusSource, Source
from schemas.runtime.bus import BusError, open_bus
from schemas.runtime.process import ConfigError, Heartbeat, load_config, log, run_node
from schemas.runtime.realtime import yield_to_others

NAME = "cockpit"


def listen(host: str, port: int) -> socket.socket:
    """A listening socket on `port`, or on a free one if that is held."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for choice in (port, 0):
        listener = socket.socket(family)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((host, choice))
            listener.listen(16)
        except OSError as error:
            listener.close()
            if choice == 0:
                raise ConfigError(f"the page cannot be served on {host}: {error.strerror}") from None
        else:
            return listener
    raise AssertionError


def address(listener: socket.socket) -> str:
    """Where the page is."""
    host, port = listener.getsockname()[:2]
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/"


class _Server(uvicorn.Server):
    """Leaves the signals to us."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


async def serve(
    source: Source,
    listener: socket.socket,
    *,
    writable: bool,
    ready: Callable[[Hub], None] = lambda _: None,
    heart: Heartbeat | None = None,
) -> None:
    """Show `source` on `listener` until SIGINT or SIGTERM."""
    hub = Hub(source)
    server = _Server(
        uvicorn.Config(
            application(hub, writable=writable),
            log_config=None,
            access_log=False,
            server_header=False,
            ws="websockets-sansio",
            ws_max_size=MAX_IN_BYTES,
            ws_ping_interval=20.0,
            ws_ping_timeout=20.0,
            limit_concurrency=64,
            timeout_graceful_shutdown=1,
            lifespan="off",
        )
    )

    def stop() -> None:
        server.should_exit = True

    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop)
    ready(hub)
    pumping = asyncio.create_task(hub.run())
    pumping.add_done_callback(lambda _: stop())  # a page without a picture is worth nothing: be started again
    await server.serve([listener])
    if not pumping.done():
        pumping.cancel()
    elif (error := pumping.exception()) is not None:
        raise error


def main() -> None:
    config = load_config(CockpitConfig, sys.argv[1:])
    listener = listen(config.host, config.port)
    scheduling = yield_to_others() if config.polite else "off"
    port = float(listener.getsockname()[1])
    try:
        with open_bus(config.bus) as bus:
            hubs: list[Hub] = []
            with Heartbeat(bus, NAME, lambda: {"port": port, **(hubs[0].metrics() if hubs else {})}):

                def ready(hub: Hub) -> None:
                    hubs.append(hub)
                    log(NAME, "ready", address(listener), realtime=scheduling)

                asyncio.run(serve(BusSource(bus), listener, writable=config.writable, ready=ready))
    except BusError as error:
        raise ConfigError(f"the bus cannot be reached: {error}") from None


if __name__ == "__main__":
    sys.exit(run_node(NAME, main))
