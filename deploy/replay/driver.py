"""Where another driver would have decided otherwise, on the recorded road."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from deploy.replay.check import NodeFactory
from deploy.replay.tape import Answered, Tape
from schemas.wire.messages import Action, MetaAction


@dataclass
class Disagreement:
    """Where another driver would have decided otherwise, tick by tick on the recorded road."""

    ticks: int = 0
    otherwise: int = 0
    table: Counter[tuple[str, str]] = field(default_factory=Counter)
    """(recorded, other) actions, where they differ."""
    first: list[dict[str, Any]] = field(default_factory=list)
    """The first of them."""

    KEPT = 10

    def add(self, step: Answered, other: Action) -> None:
        self.ticks += 1
        if other.meta_action == step.action.meta_action:
            return
        self.otherwise += 1
        pair = MetaAction(step.action.meta_action).name, MetaAction(other.meta_action).name
        self.table[pair] += 1
        if len(self.first) < self.KEPT:
            self.first.append(
                {
                    "epoch": step.action.epoch,
                    "tick": step.action.answers_tick,
                    "recorded": pair[0],
                    "other": pair[1],
                    "recorded_by": step.action.source,
                    "other_by": other.source,
                }
            )


def compare_driver(tape: Tape, node_of: NodeFactory) -> Disagreement:
    """What another driver makes of the same observations and directives. Its own actions are without consequence."""
    found = Disagreement()
    node = node_of()
    for step in tape.answered():
        if isinstance(step, Action):
            continue
        if step.fresh:
            node = node_of()
        found.add(step, node.step(step.observation, step.directive, step.arrived_ns)[0])
    return found
