"""What programs are told of the car's health: by the functions, and over HTTP by the cockpit's own process."""

from __future__ import annotations

import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from deploy.cockpit.health import MOST_METRICS, MOST_NODES, ailments, exposition
from deploy.cockpit.picture import SILENT_NS
from deploy.run.launch import children, python_module
from deploy.run.processes import free_port
from schemas.runtime.bus import BusConfig, open_bus
from schemas.runtime.clock import NS
from schemas.wire import topics
from schemas.wire.messages import Status
from tests.waiting import until


def beat(node: str, stamp_ns: int = 10 * NS, **more: object) -> Status:
    return Status(epoch=1, stamp_ns=stamp_ns, node=node, pid=1, seq=0, **({"state": "ready"} | more))  # type: ignore[arg-type]


def samples(*heartbeats: Status, now_ns: int = 10 * NS) -> dict[tuple[str, str], float]:
    """By name and the value of its one label, as Prometheus' own parser reads them."""
    text = exposition(heartbeats, now_ns).decode()
    return {
        (sample.name, next(iter(sample.labels.values()))): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_a_car_whose_nodes_beat_is_well():
    assert ailments([beat("sim"), beat("fast")], 10 * NS + SILENT_NS) == []


def test_a_car_without_a_driver_is_not():
    assert ailments([beat("sim"), beat("slow")], 10 * NS) == ["fast has not been heard of"]
    assert ailments([beat("sim"), beat("fast", 6 * NS)], 10 * NS) == ["fast has been silent for 4 s"]


def test_the_slow_node_may_be_gone():
    assert ailments([beat("sim"), beat("fast"), beat("slow", 0)], 10 * NS) == []


def test_every_metric_of_every_node_is_exposed_under_its_node():
    told = samples(beat("sim", metrics={"missed": 3.0}), beat("fast", metrics={"missed": 1.0, "tick_p50_us": 0.25}))
    assert told["fastslow_node_missed", "sim"] == 3.0
    assert told["fastslow_node_missed", "fast"] == 1.0
    assert told["fastslow_node_tick_p50_us", "fast"] == 0.25


def test_a_silent_node_is_not_ready_and_its_age_grows():
    told = samples(beat("sim"), now_ns=13 * NS)
    assert (told["fastslow_ready", "sim"], told["fastslow_heartbeat_age_seconds", "sim"]) == (0.0, 3.0)


def test_the_mode_is_one_of_four():
    told = samples(beat("sim", mode="FAIL-SAFE"))
    assert {label: value for (name, label), value in told.items() if name == "fastslow_mode"} == {
        "NOMINAL": 0.0, "DEGRADED": 0.0, "FAIL-SAFE": 1.0, "STOPPED": 0.0}  # fmt: skip


@pytest.mark.parametrize("name", ["a b", 'x"} 1\n', "é", "", "a" * 500])
def test_a_stranger_s_names_do_not_break_the_format(name):
    told = samples(beat(name, metrics={name: 1.0}))
    assert sum(name.startswith("fastslow_node_") for name, _ in told) == 1


def test_a_stranger_s_metrics_are_bounded():
    told = samples(beat("x", metrics={f"m{k}": 1.0 for k in range(1000)}))
    assert sum(name.startswith("fastslow_node_") for name, _ in told) == MOST_METRICS


def test_strangers_do_not_crowd_the_car_out():
    told = samples(*(beat(f"a{k:02}") for k in range(MOST_NODES)), beat("sim"), beat("fast"))
    assert {("fastslow_ready", "sim"), ("fastslow_ready", "fast")} <= set(told)


def get(url: str) -> tuple[int, str]:
    """Status code and text; 0 while nobody answers."""
    try:
        with urllib.request.urlopen(url, timeout=5) as response:
            return response.status, response.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()
    except OSError:
        return 0, ""


def test_the_cockpit_s_process_tells_health_and_metrics_over_http(tmp_path: Path) -> None:
    bus_at, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    page = f"http://127.0.0.1:{port}"
    config = {"bus": {"mode": "client", "connect": [bus_at]}, "port": port, "polite": False}
    with open_bus(BusConfig(mode="router", listen=(bus_at,))) as bus, children() as start:
        start("cockpit", python_module("deploy.cockpit", config), tmp_path / "log")
        until(lambda: get(f"{page}/healthz")[0], "nobody serves the page")
        assert get(f"{page}/healthz") == (503, "sim has not been heard of\nfast has not been heard of")

        def well() -> bool:
            for node in ("sim", "fast"):
                bus.publish(topics.STATUS, beat(node, time.monotonic_ns(), metrics={"missed": 2.0}))
            return get(f"{page}/healthz") == (200, "ok")

        until(well, "the heartbeats do not arrive")
        assert 'fastslow_node_missed{node="sim"} 2.0\n' in get(f"{page}/metrics")[1]
