"""The simulator's process: ticks the world on an absolute 15 Hz schedule, whoever is or is not listening."""

from __future__ import annotations

import gc
import os
import sys
import threading
import time
from collections import deque

import numpy as np

from schemas.runtime.bus import Bus, Subscription, ZenohBus, open_bus
from schemas.runtime.clock import MonotonicClock, Schedule
from schemas.runtime.process import Heartbeat, Trace, load_config, log, run_node
from schemas.runtime.realtime import claim, may_poll
from schemas.wire.messages import Action, MetaAction, Observation
from schemas.wire.topics import ACTION, CONTROL, EVENT, OBSERVATION, STATUS
from sim_node.config import SimConfig
from sim_node.node import SimNode

BUDGET_NS = 20_000_000
"""An answer later than this after its observation was published counts as missed."""
KEPT = 9000
"""Round trips in the percentiles: the last ten minutes."""
READER_S = 3.0
"""Tick 0 waits this long for somebody to read it; later ticks wait for nobody."""
SETTLE_S = 0.3
"""Links to the other peers come up within this time of the first."""
FAREWELL_S = 0.5
"""The heart beats at 5 Hz: its last beat, with the final figures, has 0.3 s to arrive before the session closes."""


REHEARSALS_NS = (1_500_000, 800_000, 350_000)
"""Ticks are announced this long before they are due, so that the fast node runs through one, cold caches and all.
Caches are cold again within a millisecond of idleness: the last rehearsal gains the most, the earlier ones a little."""
POLL_NS = 2_000_000
"""The answer is polled for this long, as long as the last one came within it."""


class RehearsingClock(MonotonicClock):
    """Announces the next observation shortly before its tick is due."""

    def __init__(self, bus: ZenohBus, poll: bool) -> None:
        self._bus, self._poll = bus, poll

    def sleep_until(self, due_ns: int) -> None:
        """Sleep until `due_ns`, with the announcements on the way, but for those that it is too late for."""
        for ahead_ns in REHEARSALS_NS:
            if self.now_ns() < due_ns - ahead_ns:
                super().sleep_until(due_ns - ahead_ns)
                self._bus.announce_next(OBSERVATION)
        while self._poll and self.now_ns() < due_ns:  # awake since the last announcement
            os.sched_yield()
        super().sleep_until(due_ns)


class RoundTrips:
    """Stamps every action's arrival from a thread of its own, so that the schedule's sleep never delays the stamp.

    The trace gets a row per tick, [ns] of CLOCK_MONOTONIC where it is a time: epoch, tick, published, how long until
    the first action that answers it (-1: none came), due, `put_ns`, when the next tick was due and its stamp, and the
    tick whose action that one applied.
    """

    def __init__(self, actions: Subscription[Action], trace: Trace) -> None:
        self._actions, self._trace = actions, trace
        self._published: tuple[int, int, int] = (-1, -1, 0)
        self._first_ns = -1
        self._due_ns = 0
        self.put_ns = 0
        """When the newest observation had been encoded and handed to the bus."""
        self._prompt = False
        self.newest: Action | None = None
        self.took_ns: deque[int] = deque(maxlen=KEPT)
        self.missed = 0
        self.closing = False
        """Set before the session closes, which ends the thread."""
        # Not a daemon: one that comes back from zenoh while the interpreter is being torn down aborts the process.
        threading.Thread(target=self._receive, name="actions").start()

    def published(self, observation: Observation, due_ns: int, now_ns: int) -> None:
        """The observation, which was due at `due_ns`, is about to leave; close the account of the one before."""
        if self._published[0] >= 0:
            self.missed += not 0 <= self._first_ns <= BUDGET_NS
            self._trace.add(
                *self._published,
                self._first_ns,
                self._due_ns,
                self.put_ns,
                due_ns,
                observation.stamp_ns,
                observation.applied_tick,
            )
        self._due_ns = due_ns
        self._prompt = 0 <= self._first_ns < POLL_NS
        # In this order: a late answer to the tick before must not be taken for one to this tick.
        self._published = (observation.epoch, observation.tick, now_ns)
        self._first_ns = -1

    def poll(self) -> None:
        """Look for the answer to what was just published without ever sleeping; late ones are left to the thread."""
        until_ns = time.monotonic_ns() + POLL_NS
        while self._prompt and self._first_ns < 0 and (action := self._actions.poll(until_ns)) is not None:
            self._arrived(action)

    def _receive(self) -> None:
        while True:
            try:
                action = self._actions.wait()
            except Exception as error:  # zenoh raises its own kinds when the session closes under us
                if not self.closing:
                    log("sim", "actions-ended", str(error))
                return
            self._arrived(action)

    def _arrived(self, action: Action) -> None:
        now_ns = time.monotonic_ns()
        self.newest = action
        epoch, tick, published_ns = self._published
        if (action.epoch, action.answers_tick) == (epoch, tick) and self._first_ns < 0:
            self._first_ns = now_ns - published_ns
            self.took_ns.append(self._first_ns)


class Loop:
    """The node, its round trips and the schedule, with the figures of the heartbeat and the orders from outside."""

    def __init__(self, bus: Bus, node: SimNode, trips: RoundTrips, schedule: Schedule) -> None:
        self._bus, self._node, self._trips, self._schedule = bus, node, trips, schedule
        self._orders = bus.subscribe(CONTROL)
        self._paused = False

    def tick(self, due_ns: int) -> None:
        """The tick that was due at `due_ns`, unless the world stands still: then no observation goes out, either."""
        moves = not self._paused
        for order in self._orders.take():
            moves = order.do in ("resume", "step") or (moves and order.do == "restart")
            if order.do != "restart":
                self._paused = order.do != "resume"
                continue
            try:
                self._node.restart(order.scenario, order.seed, time.monotonic_ns())
            except ValueError as error:
                log("sim", "order", str(error))
            else:
                self.publish(due_ns)
                return
        if moves:
            self._node.advance(self._trips.newest, time.monotonic_ns())
            self.publish(due_ns)

    def publish(self, due_ns: int) -> None:
        """Publish the current tick, which was due at `due_ns`."""
        observation = self._node.observation(time.monotonic_ns())
        self._trips.published(observation, due_ns, time.monotonic_ns())
        self._bus.publish(OBSERVATION, observation)
        self._trips.put_ns = time.monotonic_ns()
        for event in self._node.take_events():
            self._bus.publish(EVENT, event)

    def figures(self) -> dict[str, float]:
        """What the heartbeat shows; called from its thread."""
        node, m = self._node, self._node.metrics
        took_us = np.array(self._trips.took_ns.copy() or (0,)) / 1000.0
        p50, p99 = np.percentile(took_us, (50, 99))
        return {
            "tick": node.tick, "epoch": node.epoch, "speed_mps": node.speed_mps, "lane": node.lane,
            "ticks": m.ticks, "answered": m.answered, "missed": self._trips.missed, "collisions": m.collisions,
            "rtt_p50_us": float(p50), "rtt_p99_us": float(p99), "skipped": self._schedule.skipped,
            "episodes": m.episodes, "holds": m.holds, "failsafes": m.failsafes, "passed": m.passed,
            "reached": m.reached, "struck": m.struck, "min_ttc_s": m.min_ttc_s,
            "paused": float(self._paused),
        }  # fmt: skip


def warm_up(config: SimConfig) -> None:
    """Drive a throw-away world, so that no lazy import or cache is paid for at tick 0; then spare the collector it."""
    node = SimNode(config)
    node.reset(0)
    for tick, meta in enumerate((MetaAction.CRUISE, MetaAction.LEFT, MetaAction.RIGHT, MetaAction.SPEED_UP)):
        node.step(Action(epoch=0, stamp_ns=0, answers_tick=tick, meta_action=int(meta), source="fallback"), 0)
    gc.collect()
    gc.freeze()


def main() -> None:
    config = load_config(SimConfig, sys.argv[1:])
    trace = Trace(config.trace)
    warm_up(config)
    node = SimNode(config)
    node.reset(time.monotonic_ns() // 1_000_000)  # grows at every restart, so old actions can never be taken for new
    node.announce("at the simulator's start", time.monotonic_ns())
    scheduling = claim(config.realtime)
    poll = may_poll(scheduling)
    with open_bus(config.bus) as bus:
        for topic in (OBSERVATION, EVENT, STATUS):
            bus.announce(topic)
        trips = RoundTrips(bus.subscribe_rehearsed(ACTION, lambda _: None), trace)
        if bus.wait_for_reader(OBSERVATION, READER_S):
            time.sleep(SETTLE_S)
        schedule = Schedule(RehearsingClock(bus, poll), config.hz)
        loop = Loop(bus, node, trips, schedule)
        ticks = float("inf") if config.duration_s is None else config.duration_s * config.hz
        with Heartbeat(bus, "sim", loop.figures) as heart:
            heart.epoch = node.epoch
            log("sim", "ready", epoch=node.epoch, scenario=config.scenario, seed=config.seed, realtime=scheduling)
            try:
                loop.publish(schedule.wait())
                while node.metrics.ticks + schedule.skipped < ticks:
                    due_ns = schedule.wait()
                    heart.begin()
                    loop.tick(due_ns)
                    heart.epoch = node.epoch
                    heart.end()
                    if poll:
                        trips.poll()
            finally:
                heart.end()
                heart.state = "stopping"
                trips.closing = True
                trace.save()
                time.sleep(FAREWELL_S)


if __name__ == "__main__":
    sys.exit(run_node("sim", main))
