"""The world comes out again, through a new one that was ordered, too."""

from __future__ import annotations

from deploy.replay.check import check_world
from deploy.replay.tape import Tape
from schemas.wire.messages import Action, Control, MetaAction
from sim_node.config import SimConfig
from sim_node.node import SimNode


def test_a_world_that_was_ordered_comes_out_again() -> None:
    config, tape, now_ns = SimConfig(scenario="two-way", seed=3), Tape(), 0
    node = SimNode(config)
    node.reset(7)

    def drive(ticks: int) -> None:
        nonlocal now_ns
        action = None
        for _ in range(ticks):
            now_ns += 1
            seen = node.observation(now_ns)
            tape.observations[seen.epoch, seen.tick] = seen
            meta = int(MetaAction.SPEED_UP)
            action = Action(
                epoch=seen.epoch, stamp_ns=now_ns, answers_tick=seen.tick, meta_action=meta, source="policy"
            )
            tape.actions.append(action)
            node.advance(action, now_ns)

    drive(20)
    now_ns += 1
    tape.orders.append(Control(epoch=7, stamp_ns=now_ns, do="restart", scenario="highway", seed=5, density=2.0))
    node.restart(tape.orders[-1], now_ns)
    drive(20)
    found = check_world(tape, config)
    assert (found.checked, found.identical, found.unchecked) == (40, 40, 0)
