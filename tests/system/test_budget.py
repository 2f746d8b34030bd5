"""The budget in live processes: they drive as lock-step does, and late or second answers are without effect."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from deploy.lab.lockstep import drive
from fast_node.policies.load import load_policy
from schemas.runtime.bus import Arrivals, BusConfig, open_bus
from schemas.wire import topics
from schemas.wire.codec import decode
from schemas.wire.messages import Action, MetaAction, Observation
from sim_node.config import SimConfig
from sim_node.node import SimNode
from tests.running import ROOT

pytestmark = [pytest.mark.realtime, pytest.mark.slow]


@contextmanager
def nodes(*names: str, **config: object) -> Iterator[tuple[Any, Arrivals]]:
    """The simulator for some seconds, and the fast node with it if it is named; everything that they say is kept."""
    with tempfile.TemporaryDirectory(prefix="fs-") as folder:  # a socket's path is short
        router = f"unixsock-stream/{folder}/r"
        with open_bus(BusConfig(mode="router", listen=(router,))) as bus:
            said = bus.subscribe_all(10_000)
            running = []
            for name in names:
                text = json.dumps(
                    {
                        "bus": {"mode": "client", "connect": [router]},
                        "budget_ms": 60.0,
                        **(config if name == "sim_node" else {}),
                    }
                )
                running.append(
                    subprocess.Popen(
                        [sys.executable, "-m", name, text],
                        stderr=subprocess.PIPE,
                        env={**os.environ, "PYTHONPATH": str(ROOT)},
                    )
                )
                assert running[-1].stderr is not None
                assert b"ready" in running[-1].stderr.readline()
            try:
                yield bus, said
            finally:
                for process in running[::-1]:
                    process.terminate()
                    process.communicate(timeout=60)


def answer(seen: Observation, meta: MetaAction) -> Action:
    return Action(epoch=seen.epoch, stamp_ns=0, answers_tick=seen.tick, meta_action=int(meta), source="policy")


def heard(said: Arrivals, until_tick: int) -> tuple[list[Observation], dict[int, Action]]:
    """Observations in order, and actions by the tick that they answer, up to a tick."""
    seen: list[Observation] = []
    actions: dict[int, Action] = {}
    while not seen or seen[-1].tick < until_tick:
        arrival = said.wait()
        if arrival.topic == "observation":
            seen.append(decode(topics.OBSERVATION, arrival.payload))
        elif arrival.topic == "action" and arrival.payload:
            action = decode(topics.ACTION, arrival.payload)
            actions.setdefault(action.answers_tick, action)
    return seen, actions


@pytest.mark.parametrize("scenario", ["highway", "two-way"])
def test_live_nodes_drive_as_lock_step_does_up_to_the_first_missed_answer(scenario: str) -> None:
    with nodes("fast_node", "sim_node", scenario=scenario, seed=3) as (_, said):
        seen, actions = heard(said, 45)
    assert [observation.tick for observation in seen] == list(range(46))
    sim = SimNode(SimConfig(scenario=scenario, seed=3))
    same = 0
    for live, after, tick in zip(seen, seen[1:], drive(sim, load_policy(), lambda *_: None, 3.0), strict=False):
        if after.applied_tick != live.tick:
            break
        lockstep = tick.observation
        assert (live.rows, live.target_speed_mps, live.target_lane, live.applied_tick) == (
            lockstep.rows,
            lockstep.target_speed_mps,
            lockstep.target_lane,
            lockstep.applied_tick,
        )
        action = actions[live.tick]
        assert (action.meta_action, action.speed_goal_mps) == (tick.action.meta_action, tick.action.speed_goal_mps)
        same += 1
    assert same > 0


def test_an_action_that_comes_a_tick_late_and_a_second_answer_are_never_applied() -> None:
    with nodes("sim_node", scenario="highway", seed=3) as (bus, said):
        late: Observation | None = None
        seen: list[Observation] = []
        while len(seen) < 20:
            arrival = said.wait()
            if arrival.topic != "observation":
                continue
            seen.append(decode(topics.OBSERVATION, arrival.payload))
            now = seen[-1]
            if now.tick < 10:
                if late is not None:
                    bus.publish(topics.ACTION, answer(late, MetaAction.LEFT))
                late = now
            else:
                bus.publish(topics.ACTION, answer(now, MetaAction.CRUISE))
                bus.publish(topics.ACTION, answer(now, MetaAction.LEFT))
    assert {observation.applied_tick for observation in seen[:11]} == {-1}
    assert len({observation.target_lane for observation in seen}) == 1
    assert seen[-1].applied_tick > 0
