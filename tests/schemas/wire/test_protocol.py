"""The protocol page, taken at its word."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import schemas
from deploy.run.processes import free_port
from schemas.runtime.bus import BusConfig, open_bus
from schemas.runtime.clock import NS
from schemas.wire import topics
from sim_node.config import SimConfig
from sim_node.node import SimNode

PAGE = (Path(schemas.__file__).parent / "README.md").read_text()


def test_every_topic_is_on_the_page_with_its_ring():
    rows = dict(re.findall(r"^\| `(fastslow/ego/\w+)` .*\| (\d+) \|$", PAGE, re.M))
    assert rows == {t.key: str(t.depth) for t in topics.TOPICS}


def test_the_page_s_driver_drives_the_car_with_none_of_our_code():
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    assert "schemas" not in code.replace("schema", "").replace('"s"', "")
    port = free_port()
    with tempfile.TemporaryDirectory(prefix="fs-") as where:
        script = Path(where) / "driver.py"
        script.write_text(code)
        with open_bus(BusConfig(mode="router", listen=(f"tcp/127.0.0.1:{port}",))) as bus:
            actions = bus.subscribe(topics.ACTION)
            sim = SimNode(SimConfig(seed=5))
            sim.reset(7)
            driver = subprocess.Popen([sys.executable, str(script), str(port)], cwd=where)
            try:
                seen, applied = sim.observation(0), set[int]()
                while len(applied) < 60 and driver.poll() is None:
                    bus.publish(topics.OBSERVATION, seen)
                    action = actions.poll(time.monotonic_ns() + NS // 100)  # asked again where it was not there yet
                    if action is not None and action.answers_tick == seen.tick:
                        seen = sim.step(action, 0)
                        applied.add(seen.applied_tick)
            finally:
                driver.kill()
                driver.wait()
    assert len(applied) == 60
    assert not seen.crashed
