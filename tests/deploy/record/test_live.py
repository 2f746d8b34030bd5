"""What Foxglove and Lichtblick are served: a plain websocket client sees the road and the cars, and can only look."""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from deploy.record.channels import CHANNELS
from deploy.record.live import Viewers
from schemas.runtime.bus import Arrival
from schemas.runtime.process import ConfigError
from schemas.wire.codec import encode
from schemas.wire.messages import Observation
from sim_node.config import SimConfig
from sim_node.node import SimNode
from tests.running import RUN
from tests.waiting import until

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
PROTOCOL = Subprotocol("foxglove.sdk.v1")
MESSAGE_DATA = 1


@pytest.fixture(scope="module")
def viewers() -> Iterator[Viewers]:
    served = Viewers(0)
    yield served
    served.stop()


@pytest.fixture(scope="module")
def observation() -> Observation:
    sim = SimNode(SimConfig(scenario="two-way", seed=3))
    sim.reset(1)
    return sim.observation(time.monotonic_ns())


class Viewer:
    """A client of the protocol, as far as it takes to look."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.channels: dict[str, dict[str, Any]] = {}
        while len(self.channels) < len(CHANNELS):
            told = self.told()
            if told["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in told["channels"]}

    def told(self) -> dict[str, Any]:
        while not isinstance(text := self.connection.recv(timeout=60), str):
            pass
        found: dict[str, Any] = json.loads(text)
        return found

    def watch(self, *topics: str) -> None:
        wished = [{"id": k, "channelId": self.channels[topic]["id"]} for k, topic in enumerate(topics)]
        self.connection.send(json.dumps({"op": "subscribe", "subscriptions": wished}))

    def sees(self) -> tuple[int, dict[str, Any]]:
        """(subscription, message)."""
        while not isinstance(data := self.connection.recv(timeout=60), bytes) or data[0] != MESSAGE_DATA:
            pass
        subscription, _ = struct.unpack_from("<IQ", data, 1)
        return subscription, json.loads(data[13:])


@pytest.fixture
def viewer(viewers: Viewers) -> Iterator[Viewer]:
    with connect(viewers.address, subprotocols=[PROTOCOL]) as connection:
        yield Viewer(connection)


def subscribed(viewers: Viewers, count: int) -> None:
    until(lambda: viewers.metrics["subscriptions"] >= count, "nobody has subscribed")


def test_the_channels_are_those_of_a_recording_each_with_its_schema(viewer):
    assert {name: channel["schemaName"] for name, channel in viewer.channels.items()} == {
        channel.topic: channel.kind for channel in CHANNELS.values()
    }
    for channel in viewer.channels.values():
        assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
        assert json.loads(channel["schema"])["type"] == "object"


def test_who_comes_late_sees_the_road_too_and_every_car_in_its_place(viewers, viewer, observation):
    arrival = Arrival("observation", encode(observation), 0)
    viewers.arrived(arrival, time.monotonic_ns())  # the road has been drawn before anybody looked
    viewer.watch("/scene/road", "/scene/cars", "/observation")
    subscribed(viewers, 3)
    viewers.arrived(arrival, time.monotonic_ns())
    seen = dict(viewer.sees() for _ in range(3))
    [road], [cars] = seen[0]["entities"], seen[1]["entities"]
    assert len(road["lines"]) == len(observation.lanes)
    assert [round(cube["pose"]["position"]["x"]) for cube in cars["cubes"]] == [
        round(vehicle["x_m"]) for vehicle in seen[2]["vehicles"]
    ]


def test_a_viewer_may_look_and_nothing_else(viewer):
    assert viewer.connection.subprotocol == PROTOCOL
    command = {"id": 1, "topic": "/command", "encoding": "json", "schemaName": "fastslow.Command"}
    viewer.connection.send(json.dumps({"op": "advertise", "channels": [command]}))
    told = viewer.told()
    assert (told["op"], told["level"]) == ("status", 2)


def test_what_cannot_be_read_is_counted_and_passed_on_to_nobody(viewers):
    before = viewers.metrics["refused"]
    viewers.arrived(Arrival("observation", b"\xc1", 0), time.monotonic_ns())
    assert viewers.metrics["refused"] == before + 1


def test_a_port_that_is_held_is_named(viewers):
    with pytest.raises(ConfigError, match=f"127.0.0.1:{viewers.metrics['port']:.0f}"):
        Viewers(int(viewers.metrics["port"]))


@pytest.mark.realtime
def test_a_run_tells_where_a_viewer_connects_and_shows_it_the_car(tmp_path: Path) -> None:
    argv = [*RUN, "--no-cockpit", "--without", "llm", "--foxglove"]
    with subprocess.Popen(argv, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        assert process.stderr is not None
        try:
            found = (re.search(r"connect to (ws://127\.0\.0\.1:\d+)", line) for line in process.stderr)
            address = next(match[1] for match in found if match)
            with connect(address, subprotocols=[PROTOCOL]) as connection:
                viewer = Viewer(connection)
                viewer.watch("/scene/cars")
                assert viewer.sees()[1]["entities"][0]["cubes"]
        finally:
            process.terminate()
            process.communicate()


def test_without_the_package_a_run_names_the_extra(tmp_path: Path) -> None:
    hidden = "import sys; sys.modules['foxglove'] = None; from deploy.cli.app import main; main()"
    argv = [sys.executable, "-c", hidden, "run", "--port", "0", "--foxglove"]
    done = subprocess.run(argv, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (
        78, "fastslow: foxglove-sdk is missing: pip install 'fastslow[foxglove]'\n",
    )  # fmt: skip
