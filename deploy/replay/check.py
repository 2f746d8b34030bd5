"""Process replay: recorded inputs into fresh nodes, and every decision compared with the recorded one, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec

from deploy.replay.tape import Tape, World
from fast_node.node import FastNode
from schemas.wire.messages import Action, Event, Message
from sim_node.config import SimConfig
from sim_node.node import SimNode

NodeFactory = Callable[[], FastNode]
_TIMING = ("stamp_ns", "compute_ns")
"""Of an action: how long it took, not what it is."""


@dataclass
class Comparison:
    """How many of the recorded messages of one kind came out again."""

    checked: int = 0
    identical: int = 0
    unchecked: int = 0
    """Their inputs are not in the recording."""
    first_difference: dict[str, Any] | None = None

    def compare(self, epoch: int, tick: int, recorded: dict[str, Any], again: dict[str, Any]) -> None:
        """Count one; of the first that differs, keep the fields that do."""
        self.checked += 1
        if recorded == again:
            self.identical += 1
        elif self.first_difference is None:
            names = [name for name in recorded | again if recorded.get(name) != again.get(name)]
            self.first_difference = {
                "epoch": epoch,
                "tick": tick,
                "recorded": {name: recorded.get(name) for name in names},
                "again": {name: again.get(name) for name in names},
            }

    @property
    def share(self) -> float:
        """Of those checked; 1 where there was nothing to check."""
        return self.identical / self.checked if self.checked else 1.0


def fields_of(message: Message, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """A message as plain data; its rows as bytes."""
    fields: dict[str, Any] = msgspec.to_builtins(message, builtin_types=(bytes,))
    return {name: value for name, value in fields.items() if name not in without}


def check_fast(tape: Tape, node_of: NodeFactory) -> tuple[Comparison, Comparison]:
    """Actions, and events about directives, of the recorded steps taken again by fresh nodes."""
    actions, events = Comparison(), Comparison()
    said: list[Event] = []
    node = node_of()
    for step in tape.answered():
        if isinstance(step, Action):
            actions.unchecked += 1
            continue
        if step.fresh:
            node = node_of()
        action, news = node.step(step.observation, step.directive, step.arrived_ns)
        said += news
        recorded = step.action
        actions.compare(recorded.epoch, recorded.answers_tick, fields_of(recorded, _TIMING), fields_of(action, _TIMING))
    again = {(event.stamp_ns, event.kind, event.detail): event for event in said}
    gaps = tape.gaps()
    for event in tape.events:
        if event.tick >= gaps.get(event.epoch, event.tick + 1):
            events.unchecked += 1
            continue
        twin = again.get((event.stamp_ns, event.kind, event.detail))
        events.compare(event.epoch, event.tick, fields_of(event), fields_of(twin) if twin else {})
    return actions, events


def check_world(tape: Tape, config: SimConfig) -> Comparison:
    """Observations of the recorded actions, driven again in the same traffic from the run's seed.

    Which action a tick applied stands in its observation. A world of which ticks are missing is driven as far as the
    gap; one that began before the recording did is not driven at all.
    """
    observations = Comparison()
    answers = {(action.epoch, action.answers_tick): action for action in tape.actions}
    node = SimNode(config)
    epoch, ended_ns = None, 0
    for world in tape.worlds():
        first = world[0]
        if epoch is None or first.epoch != epoch + 1:  # a new process: the run's seed again
            node = SimNode(config)
            node.reset(first.epoch)
        elif order := next((o for o in tape.orders if ended_ns <= o.stamp_ns <= first.stamp_ns), None):
            node.restart(order, 0)
        elif not node.over:  # the world before was not seen to its end, so that its end is not known
            observations.unchecked += len(world)
            continue
        else:
            node.advance(None, 0)
        epoch, ended_ns = first.epoch, world[-1].stamp_ns
        done = _drive(node, world, answers, observations)
        observations.unchecked += len(world) - done
    return observations


def _drive(node: SimNode, world: World, answers: dict[tuple[int, int], Action], found: Comparison) -> int:
    """Compare one world from tick 0; returns how many ticks were compared."""
    applied = -1
    for tick, recorded in enumerate(world):
        if recorded.tick != tick:
            return tick
        if tick:
            action = None
            if recorded.applied_tick != applied:
                action = answers.get((recorded.epoch, recorded.applied_tick))
                if action is None:
                    return tick
            applied = recorded.applied_tick
            node.advance(action, 0)
        again = node.observation(recorded.stamp_ns)
        found.compare(recorded.epoch, tick, fields_of(recorded), fields_of(again))
    return len(world)
