"""The protocol page, taken at its word."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import schemas
from schemas.runtime.bus import BusConfig, open_bus
from schemas.wire import topics
from schemas.wire.messages import Observation
from sim_node.config import SimConfig
from sim_node.node import SimNode

PAGE = (Path(schemas.__file__).parent / "README.md").read_text()


def test_every_topic_is_on_the_page_with_its_ring():
    rows = dict(re.findall(r"^\| `(fastslow/ego/\w+)` .*\| (\d+) \|$", PAGE, re.M))
    assert rows == {t.key: str(t.depth) for t in topics.TOPICS}


def test_the_page_s_driver_drives_the_car_with_none_of_our_code():
    code = re.search(r"```python\n(.*?)```", PAGE, re.S)[1]
    assert "schemas" not in code.replace("schema", "").replace('"s"', "")
    port = 17473
    with tempfile.TemporaryDirectory(prefix="fs-") as where:
        script = Path(where) / "driver.py"
        script.write_text(code)
        with open_bus(BusConfig(mode="router", listen=(f"tcp/127.0.0.1:{port}",))) as bus:
            actions = bus.subscribe(topics.ACTION)
            sim = SimNode(SimConfig(seed=5))
            sim.reset(7)
            driver = subprocess.Popen([sys.executable, str(script), str(port)], cwd=where)
            try:
                bus.publish(topics.OBSERVATION, seen := sim.observation(0))
                applied, until = set(), time.monotonic() + 30
                while time.monotonic() < until and len(applied) < 60:
                    time.sleep(0.01)
                    taken = actions.take()
                    if taken:
                        seen = sim.step(taken[-1], 0)
                        applied.add(seen.applied_tick)
                    bus.publish(topics.OBSERVATION, seen)
            finally:
                driver.kill()
                driver.wait()
    assert isinstance(seen, Observation)
    assert len(applied) >= 60
    assert not seen.crashed
