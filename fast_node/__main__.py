"""`python -m fast_node '{"bus": {...}}'`: answer every observation with an action."""

from __future__ import annotations

import gc
import sys
import time
from pathlib import Path

import msgspec
import numpy as np

from fast_node.config import FastConfig
from fast_node.node import FastNode
from fast_node.policy import SHIPPED, load_policy
from schemas import topics
from schemas.bus import open_bus
from schemas.messages import ROW_COLUMNS, Lane, Observation
from schemas.process import Heartbeat, load_config, log, run_node


def warm_up(config: FastConfig, node: FastNode) -> None:
    """Pay for the first inferences before going live."""
    rows = np.zeros((8, len(ROW_COLUMNS)), np.float32)
    rows[:, 0], rows[:, 1], rows[:, 6:8] = np.arange(8), np.arange(8) * 30.0, (5.0, 2.0)
    lanes = (Lane(y_m=0.0, start_m=0.0, end_m=1e4), Lane(y_m=4.0, start_m=0.0, end_m=1e4))
    for tick in range(20):
        node.step(Observation(epoch=-2, stamp_ns=0, tick=tick, scenario="warm-up", lanes=lanes, rows=rows.tobytes()),
                  None, 0)
    node.counts = dict.fromkeys(node.counts, 0)
    gc.collect()
    gc.freeze()


def main() -> None:
    config = load_config(FastConfig, sys.argv[1:])
    node = FastNode(config, load_policy(Path(config.policy) if config.policy else SHIPPED))
    warm_up(config, node)
    with open_bus(config.bus) as bus:
        bus.announce(topics.ACTION)
        observations = bus.subscribe(topics.OBSERVATION)
        directives = bus.subscribe(topics.DIRECTIVE)
        with Heartbeat(bus, "fast", lambda: {k: float(v) for k, v in node.counts.items()}) as heart:
            log("fast", "ready")
            while True:
                observation = observations.wait()
                arrived_ns = time.monotonic_ns()
                heart.begin()
                heart.epoch = observation.epoch
                action, events = node.step(observation, directives.peek(), arrived_ns)
                now_ns = time.monotonic_ns()
                bus.publish(topics.ACTION, msgspec.structs.replace(
                    action, stamp_ns=now_ns, compute_ns=now_ns - arrived_ns))
                for event in events:
                    bus.publish(topics.EVENT, event)
                heart.end()


if __name__ == "__main__":
    sys.exit(run_node("fast", main))
