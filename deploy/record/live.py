"""`python -m deploy.record.live '{"bus": {...}}'`: what is said on the bus, live for Foxglove and Lichtblick.

The channels are those of a recording, so that a layout fits both. It listens on loopback, and a viewer may look only. A
process of its own, in the idle scheduling class: a slow viewer loses messages, and the loop no tick.
"""

from __future__ import annotations

import sys
import time

from deploy.record.channels import CHANNELS, Translator
from deploy.run.processes import FOXGLOVE_PORT
from schemas.runtime.bus import Arrival, Arrivals, open_bus
from schemas.runtime.process import ConfigError, Heartbeat, NodeConfig, load_config, log, run_node
from schemas.runtime.realtime import yield_to_others
from schemas.wire.topics import STATUS

NAME = "foxglove"
PENDING = 256
"""Messages that wait for us: a viewer wants the newest."""
BACKLOG = 256
"""Messages that wait for one viewer; then it loses the oldest."""


class LiveConfig(NodeConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What `python -m deploy.record.live` takes."""

    port: int = FOXGLOVE_PORT
    """On 127.0.0.1."""

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port {self.port} is not within 0..65535")


class Viewers:
    """Serves whoever connects. Raises `ConfigError` without foxglove-sdk, or where the port is held."""

    def __init__(self, port: int) -> None:
        try:
            import foxglove
        except ImportError:
            raise ConfigError("foxglove-sdk is missing: pip install 'fastslow[foxglove]'") from None
        self._translator = Translator(time.time_ns() - time.monotonic_ns())
        self._context = foxglove.Context()  # the channels go with it
        self._channels = {
            name: foxglove.Channel(
                channel.topic,
                schema=foxglove.Schema(name=channel.kind, encoding="jsonschema", data=channel.schema),
                message_encoding="json",
                context=self._context,
            )
            for name, channel in CHANNELS.items()
        }
        self.metrics = {"port": 0.0, "messages": 0.0, "refused": 0.0, "subscriptions": 0.0}
        try:
            self._server = foxglove.start_server(
                name="fastslow",
                host="127.0.0.1",
                port=port,
                capabilities=[],
                server_listener=self,
                context=self._context,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            raise ConfigError(f"viewers cannot be served on 127.0.0.1:{port}: {error}") from None
        self.metrics["port"] = float(self._server.port)

    @property
    def address(self) -> str:
        """What a viewer connects to."""
        return f"ws://127.0.0.1:{self._server.port}"

    def arrived(self, arrival: Arrival, now_ns: int) -> None:
        """Pass on what came, seen at `now_ns` of CLOCK_MONOTONIC."""
        message = self._translator.message(arrival, now_ns)
        if message is None:
            self.metrics["refused"] += 1
            return
        self.metrics["messages"] += 1
        for name, data in self._translator.parts(arrival.topic, message):
            self._channels[name].log(data, log_time=self._translator.sent_ns(message))

    def on_subscribe(self, client: object, channel: object) -> None:
        """For the server, from a thread of its: somebody looks now, who has not seen the road yet."""
        self.metrics["subscriptions"] += 1
        self._translator.redraw()

    def on_unsubscribe(self, client: object, channel: object) -> None:
        """For the server."""
        self.metrics["subscriptions"] -= 1

    def stop(self) -> None:
        """Let everybody go."""
        self._server.stop()


def serve(viewers: Viewers, arrivals: Arrivals) -> None:
    """Until a signal comes."""
    while True:
        viewers.arrived(arrivals.wait(), time.monotonic_ns())


def main() -> None:
    config = load_config(LiveConfig, sys.argv[1:])
    with open_bus(config.bus) as bus:
        arrivals = bus.subscribe_all(PENDING)
        scheduling = yield_to_others()
        viewers = Viewers(config.port)
        bus.announce(STATUS)
        with Heartbeat(bus, NAME, lambda: dict(viewers.metrics), stuck_s=60.0):
            log(NAME, "ready", viewers.address, realtime=scheduling)
            try:
                serve(viewers, arrivals)
            finally:
                viewers.stop()


if __name__ == "__main__":
    sys.exit(run_node(NAME, main))
