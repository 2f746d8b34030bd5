"""A lock-step drive as pictures: the nodes that drive, one picture per tick."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from fast_node.config import FastConfig
from fast_node.node import FastNode
from schemas.driving.road import HZ
from schemas.runtime.clock import NS
from schemas.wire.messages import Action, Directive, Event, Observation
from sim_node.config import SimConfig
from sim_node.node import SimNode

NOTE_S = 4.0
"""How long an event is shown."""


@dataclass(frozen=True)
class Shot:
    """What there is to see at one tick."""

    observation: Observation
    action: Action
    directive: Directive | None
    note: str = ""


def drive(
    node: FastNode, config: SimConfig, duration_s: float, ask: Callable[[Observation, int], Directive | None]
) -> Iterator[Shot]:
    """Drive one episode in lock-step, until it is over or `duration_s` have passed.

    `ask`: called at every tick with the observation and the time [ns]; a new directive, or None.
    """
    sim = SimNode(config)
    sim.reset(1)
    seen, directive = sim.observation(0), None
    note, until = "", -1
    for k in range(round(duration_s * HZ)):
        now_ns = k * NS // HZ
        directive = ask(seen, now_ns) or directive
        action, events = node.step(seen, directive, now_ns)
        for event in events:
            note, until = worded(event), k + round(NOTE_S * HZ)
        yield Shot(seen, action, directive, note if k < until else "")
        seen = sim.step(action, now_ns + NS // HZ)
        if sim.over:
            return


def worded(event: Event) -> str:
    """An event in a few words."""
    why = f": {event.rule}" if event.rule and event.kind != "fulfilled" else ""
    car = f" (car {event.vehicle})" if why and event.vehicle >= 0 else ""
    return f"{event.kind}{why}{car}"


def default_node(node_config: FastConfig | None = None) -> FastNode:
    """The fast node with the shipped policy."""
    from fast_node.policies.attention import load_policy

    policy = load_policy()
    return FastNode(node_config or FastConfig(), policy, policy.preset)
