"""The protocol page, taken at its word."""

from __future__ import annotations

import json
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
from schemas.wire import messages as m
from schemas.wire import topics
from sim_node.config import SimConfig
from sim_node.node import SimNode
from tests.waiting import until

PAGE = (Path(schemas.__file__).parent / "README.md").read_text()


def test_every_topic_is_on_the_page_with_its_ring():
    rows = dict(re.findall(r"^\| `(fastslow/ego/\w+)` .*\| (\d+) \|$", PAGE, re.M))
    assert rows == {t.key: str(t.depth) for t in topics.TOPICS}


def test_every_field_that_travels_is_on_the_page_but_those_of_thoughts_and_the_journal():
    spoken = (m.Observation, m.Lane, m.Action, m.Directive, m.Command, m.Reply, m.Event, m.Status, m.Control)
    missing = [
        f"{kind.__name__}.{field}" for kind in spoken for field in kind.__struct_fields__ if f"`{field}`" not in PAGE
    ]
    assert missing == []


def test_the_page_s_driver_drives_the_car_with_none_of_our_code():
    code, _ = re.findall(r"```python\n(.*?)```", PAGE, re.S)
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


def test_a_message_that_cannot_be_used_is_answered_with_the_reason_on_the_bus():
    with tempfile.TemporaryDirectory(prefix="fs-") as where:
        router = f"unixsock-stream/{where}/r"
        with open_bus(BusConfig(mode="router", listen=(router,))) as bus:
            heard = bus.subscribe(topics.STATUS)
            config = json.dumps({"bus": {"mode": "client", "connect": [router]}})
            sim = subprocess.Popen([sys.executable, "-m", "sim_node", config], cwd=Path(schemas.__file__).parents[1])
            try:
                until(lambda: heard.take(), "the simulator has no heartbeat")
                bad = m.Action(epoch=1, stamp_ns=0, answers_tick=0, meta_action=9, source="policy")
                bus.publish(topics.ACTION, bad)
                said = until(lambda: next((s.detail for s in heard.take() if s.detail), ""), "nobody says why")
            finally:
                sim.terminate()
                sim.wait()
    assert said == "1 payloads refused, the last on action: meta_action 9 is not within 0..5"
