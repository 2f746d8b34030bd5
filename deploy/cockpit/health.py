"""How the car is, for programs: `/healthz` for who restarts it, `/metrics` for Prometheus. Both read the heartbeats."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any, get_args

from prometheus_client.core import GaugeMetricFamily, Metric, UnknownMetricFamily
from prometheus_client.exposition import generate_latest

from deploy.cockpit.picture import SILENT_NS
from schemas.runtime.clock import NS
from schemas.wire.messages import Mode, Status
from schemas.wire.text import plain

MUST_LIVE = ("sim", "fast")
MOST_NODES, MOST_METRICS = 32, 64
"""Of all nodes, and of one: anybody on the bus may name them."""
_NO_NAME = re.compile("[^a-zA-Z0-9_]")


def ailments(heartbeats: Iterable[Status], now_ns: int) -> list[str]:
    """Why the car is not driven, one line each; none: it is."""
    silent_ns = {status.node: now_ns - status.stamp_ns for status in heartbeats}
    never = [f"{name} has not been heard of" for name in MUST_LIVE if name not in silent_ns]
    late = [name for name in MUST_LIVE if silent_ns.get(name, 0) > SILENT_NS]
    return [*never, *(f"{name} has been silent for {silent_ns[name] / NS:.0f} s" for name in late)]


def exposition(heartbeats: Sequence[Status], now_ns: int) -> bytes:
    """All that the heartbeats say, in Prometheus' text format. A node's own metric `m` is `fastslow_node_m`."""
    ours_first = sorted(heartbeats, key=lambda status: status.node not in MUST_LIVE)
    return generate_latest(_Collected([*_of_the_nodes(ours_first[:MOST_NODES], now_ns)]))


class _Collected:
    """What `generate_latest` asks of a registry."""

    def __init__(self, families: list[Metric]) -> None:
        self._families = families

    def collect(self) -> list[Metric]:
        return self._families


def _of_the_nodes(heartbeats: Sequence[Status], now_ns: int) -> Iterable[Metric]:
    ready = GaugeMetricFamily("fastslow_ready", "1: the node is heard of and ready.", labels=["node"])
    age = GaugeMetricFamily("fastslow_heartbeat_age_seconds", "Since the newest heartbeat.", labels=["node"])
    mode = GaugeMetricFamily("fastslow_mode", "1: the car is driven in this mode.", labels=["mode"])
    own: dict[str, Metric] = {}
    for status in heartbeats:
        node, silent_ns = plain(status.node, 40), now_ns - status.stamp_ns
        ready.add_metric([node], float(status.state == "ready" and silent_ns <= SILENT_NS))
        age.add_metric([node], silent_ns / NS)
        if status.mode:
            for each in get_args(Mode):
                mode.add_metric([each], float(each == status.mode))
        for name, value in _named(status.metrics):
            told = "Of the node's heartbeat; schemas/README.md says what it counts."
            family = own.setdefault(name, UnknownMetricFamily(f"fastslow_node_{name}", told, labels=["node"]))
            family.add_sample(family.name, {"node": node}, value)
    return [ready, age, mode, *own.values()]


def _named(metrics: dict[str, float]) -> Iterable[tuple[str, Any]]:
    """Metrics under names that Prometheus takes; of two that become the same, the last."""
    return {_NO_NAME.sub("_", name)[:80]: value for name, value in islice(metrics.items(), MOST_METRICS)}.items()
