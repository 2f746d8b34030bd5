"""`fastslow status`, on a real bus."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

from deploy.run.processes import free_port
from schemas.runtime.bus import BusConfig, open_bus
from schemas.wire import topics
from schemas.wire.messages import Status

ROOT = Path(__file__).parents[3]


def test_watching_goes_on_until_no_node_is_alive():
    port, stop = free_port(), Event()
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    words = [sys.executable, "-m", "deploy", "status", "--watch", "--json", "--port", str(port)]
    with (
        open_bus(BusConfig(mode="router", listen=(f"tcp/127.0.0.1:{port}",))) as bus,
        subprocess.Popen(words, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as watching,
    ):

        def beat(node: str) -> None:
            bus.publish(
                topics.STATUS, Status(epoch=1, stamp_ns=time.monotonic_ns(), node=node, pid=1, seq=0, state="ready")
            )

        beating = Thread(target=_often, args=(stop, beat), daemon=True)
        beating.start()
        try:
            assert watching.stdout is not None
            for _ in range(2):
                shown = json.loads(watching.stdout.readline())
                assert [node["node"] for node in shown["nodes"]] == ["fast", "sim"]
        finally:
            stop.set()
        beating.join()
        _, error = watching.communicate(timeout=60)
    assert (watching.returncode, error) == (69, f"fastslow: no node is alive behind 127.0.0.1:{port}\n")


def _often(stop: Event, beat: Callable[[str], None]) -> None:
    while not stop.wait(0.1):
        beat("sim")
        beat("fast")
