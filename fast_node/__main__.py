"""`python -m fast_node '{"bus": {...}}'`: answer every observation with an action."""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from fast_node import node as node_module
from fast_node.config import FastConfig
from fast_node.mask import PRESETS
from fast_node.node import FastNode
from fast_node.policies.load import load_policy
from fast_node.policies.outsider import DeadlinePolicy, WatchedPolicy
from fast_node.policies.policy import NamedPolicy, Policy
from fast_node.policies.rule import RulePolicy
from schemas.driving.road import ID, LANE, LENGTH, WIDTH, X, Y
from schemas.runtime.bus import open_bus
from schemas.runtime.process import Heartbeat, Trace, load_config, log, run_node
from schemas.runtime.realtime import claim, may_poll
from schemas.wire import topics
from schemas.wire.messages import ROW_COLUMNS, Directive, Lane, Observation

POLL_NS = 1_000_000
"""An observation is polled for this long after its announcement; the next announcement or it comes within 0.7 ms."""
POLICY_SHARE = 0.6
"""Of the budget is the policy's; the rest is for the way there and back, and for the rule, should it be needed."""
PARTS = ("close_actions", "features", "logits")
"""What the benchmark times within a step: the mask, the features, the policy."""


def warm_up(node: FastNode) -> None:
    """Pay for the first inferences before going live: without words, and with a way into a lane to be planned."""
    rows = np.zeros((8, len(ROW_COLUMNS)), np.float32)
    rows[:, ID], rows[:, X], rows[:, [LENGTH, WIDTH]] = np.arange(8), np.arange(8) * 30.0, (5.0, 2.0)
    rows[2::2, LANE], rows[2::2, Y] = 1, 4.0
    lanes = (Lane(y_m=0.0, start_m=0.0, end_m=1e4), Lane(y_m=4.0, start_m=0.0, end_m=1e4))
    over = Directive(epoch=-2, stamp_ns=0, id=1, command_id=1, scene_tick=0, target_lane=1)
    for tick in range(20):
        seen = Observation(
            epoch=-2, stamp_ns=0, tick=tick, scenario="warm-up", lanes=lanes, rows=rows.tobytes(), goal_x_m=1e3
        )
        node.step(seen, None if tick < 10 else over, 0)
    gc.collect()
    gc.freeze()


def time_parts(policy: object) -> dict[str, int]:
    """Have the parts of every step add their nanoseconds to the dictionary that is returned."""
    spent = dict.fromkeys(PARTS, 0)

    def timed(name: str, part: Callable[..., Any]) -> Callable[..., Any]:
        def wrapper(*args: Any, **more: Any) -> Any:
            start = time.monotonic_ns()
            result = part(*args, **more)
            spent[name] += time.monotonic_ns() - start
            return result

        return wrapper

    for owner in (node_module, policy):
        for name in PARTS:
            if hasattr(owner, name):
                setattr(owner, name, timed(name, getattr(owner, name)))
    return spent


def nodes_of(config: FastConfig, policy: NamedPolicy) -> tuple[FastNode, FastNode]:
    """The node that drives, and the one that rehearses for it.

    What may remember or be slow is asked under a deadline, and not once more than the road asks: the rule rehearses. So
    is what turns slow. The deadline leaves time for the rule's answer within the budget.
    """
    limit_s = POLICY_SHARE * config.budget_ms / 1e3
    drives: Policy = WatchedPolicy(policy, limit_s) if policy.stateless else DeadlinePolicy(policy, limit_s)
    rehearses: Policy = policy if policy.stateless else RulePolicy()
    preset, stateless = PRESETS[policy.mask_preset], policy.stateless
    return FastNode(config, drives, preset, stateless=stateless), FastNode(config, rehearses, preset, stateless=True)


def main() -> None:
    config = load_config(FastConfig, sys.argv[1:])
    policy = load_policy(config.policy)
    node, rehearser = nodes_of(config, policy)
    warm_up(rehearser)
    trace, spent = Trace(config.trace), time_parts(policy) if config.trace else {}
    scheduling = claim(config.realtime)
    with open_bus(config.bus) as bus:
        bus.announce(topics.ACTION)

        def rehearse(last: Observation) -> None:
            """Answer the last observation once more, without consequence."""
            rehearser.rehearse(node, last, directives.peek())
            bus.announce_next(topics.ACTION)

        observations = bus.subscribe_rehearsed(topics.OBSERVATION, rehearse, POLL_NS if may_poll(scheduling) else 0)
        directives = bus.subscribe(topics.DIRECTIVE)
        with Heartbeat(bus, "fast", lambda: {k: float(v) for k, v in node.counts.items()}) as heart:
            log("fast", "ready", realtime=scheduling)
            try:
                while True:
                    observation = observations.wait()
                    decoded_ns = time.monotonic_ns()
                    heart.begin()
                    heart.epoch = observation.epoch
                    spent.update(dict.fromkeys(spent, 0))
                    action, events = node.step(observation, directives.peek(), observations.arrived_ns)
                    now_ns = time.monotonic_ns()
                    bus.publish(
                        topics.ACTION,
                        msgspec.structs.replace(action, stamp_ns=now_ns, compute_ns=now_ns - observations.arrived_ns),
                    )
                    trace.add(
                        observation.epoch,
                        observation.tick,
                        observations.arrived_ns,
                        decoded_ns,
                        *spent.values(),
                        now_ns,
                        time.monotonic_ns(),
                    )
                    for event in events:
                        bus.publish(topics.EVENT, event)
                    heart.end()
            finally:
                trace.save()


if __name__ == "__main__":
    sys.exit(run_node("fast", main))
