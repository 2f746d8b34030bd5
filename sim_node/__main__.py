"""The simulator's process. At 15 Hz, on an absolute schedule, it publishes what the ego sees, waits for the answer
within the budget, and steps the world with it or without."""

from __future__ import annotations

import gc
import os
import sys
import threading
import time
from queue import Empty, SimpleQueue

import numpy as np

from schemas.runtime.bus import Bus, Subscription, ZenohBus, open_bus
from schemas.runtime.clock import NS, MonotonicClock, Schedule
from schemas.runtime.process import ConfigError, Heartbeat, Trace, load_config, log, run_node
from schemas.runtime.realtime import claim, may_poll
from schemas.wire.messages import Action, Event, EventKind, MetaAction, Observation
from schemas.wire.topics import ACTION, CONTROL, EVENT, OBSERVATION, STATUS
from sim_node.config import SimConfig
from sim_node.gate import Gate
from sim_node.node import SimNode

READER_S = 3.0
"""Tick 0 waits this long for somebody to read it; later ticks wait for nobody."""
SETTLE_S = 0.3
"""Links to the other peers come up within this time of the first."""
FAREWELL_S = 0.5
"""The heart beats at 5 Hz: its last beat, with the final metrics, has 0.3 s to arrive before the session closes."""


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


class Answers:
    """The actions as they come, and the wait for the one that answers what was just published.

    A thread of its own stamps each at its arrival and hands it on; whoever waits sleeps until then, and so leaves the
    core to the fast node where both share one. The trace gets a row per tick, [ns] of CLOCK_MONOTONIC where it is a
    time: epoch, tick, published, how long until the first answer (-1: none came), due, `put_ns`, when the next tick was
    due and its stamp, and the age of the action that was applied (-1: none was).
    """

    def __init__(self, actions: Subscription[Action], gate: Gate, trace: Trace, poll: bool) -> None:
        self._actions, self._trace, self._poll = actions, trace, poll
        self.gate = gate
        self._came: SimpleQueue[tuple[Action, int]] = SimpleQueue()
        self._asked: tuple[int, int, int] | None = None
        self._prompt = False
        self.put_ns = 0
        """When the newest observation had been encoded and handed to the bus."""
        self.closing = False
        """Set before the session closes, which ends the thread."""
        # Not a daemon: one that comes back from zenoh while the interpreter is being torn down aborts the process.
        threading.Thread(target=self._receive, name="actions").start()

    def expect(self, observation: Observation, due_ns: int) -> None:
        """The observation, which was due at `due_ns`, is about to leave; close the account of the one before."""
        gate = self.gate
        while not self._came.empty():
            gate.arrived(*self._came.get_nowait())
        if self._asked is not None:
            epoch, tick, was_due_ns = self._asked
            self._trace.add(
                epoch,
                tick,
                gate.published_ns,
                gate.took_ns,
                was_due_ns,
                self.put_ns,
                due_ns,
                observation.stamp_ns,
                gate.age_ns,
            )
        self._asked = observation.epoch, observation.tick, due_ns
        self._prompt = 0 <= gate.took_ns < POLL_NS
        gate.open(observation.epoch, observation.tick, time.monotonic_ns())

    def wait(self) -> Action | None:
        """The answer as soon as it is there; None once the budget is over."""
        gate = self.gate
        if self._poll and self._prompt:
            self._look(min(gate.published_ns + POLL_NS, gate.until_ns))
        while gate.took_ns < 0:
            left_ns = gate.until_ns - time.monotonic_ns()
            try:
                gate.arrived(*self._came.get(timeout=max(left_ns, 0) / NS))
            except Empty:
                break
        return gate.close(time.monotonic_ns())

    def _look(self, until_ns: int) -> None:
        """Look for the answer without sleeping; the thread may have been quicker."""
        while self.gate.took_ns < 0 and time.monotonic_ns() < until_ns:
            if (action := self._actions.poll(0)) is not None:
                self.gate.arrived(action, time.monotonic_ns())
            elif not self._came.empty():
                self.gate.arrived(*self._came.get_nowait())
            else:
                os.sched_yield()

    def _receive(self) -> None:
        while True:
            try:
                action = self._actions.wait()
            except Exception as error:  # zenoh raises its own kinds when the session closes under us
                if not self.closing:
                    log("sim", "actions-ended", str(error))
                return
            self._came.put((action, time.monotonic_ns()))


class Loop:
    """The node, its answers and the schedule, with the metrics of the heartbeat and the orders from outside."""

    def __init__(self, bus: Bus, node: SimNode, answers: Answers, schedule: Schedule) -> None:
        self._bus, self._node, self._answers, self._schedule = bus, node, answers, schedule
        self._orders = bus.subscribe(CONTROL)
        self._paused = False
        self._answer: Action | None = None
        self._strays, self._strays_told_ns = 0, 0
        self._shown = False
        """The present state is published, and its answer waits with it until the world goes on."""

    def tick(self, due_ns: int) -> None:
        """The tick that was due at `due_ns`: show the present state, wait for the answer, step the world with it.

        A world that stands still does nothing; after a single step, or a restart meanwhile, it has shown its state and
        keeps the answer until it goes on.
        """
        if not self._obey():
            return
        if self._shown:
            self._step()
        self.show(due_ns)
        if not self._paused:
            self._step()

    def _obey(self) -> bool:
        """Take the orders; whether there is anything to do at this tick."""
        goes = not self._paused
        for order in self._orders.take():
            if order.do == "restart":
                try:
                    self._node.restart(order, time.monotonic_ns())
                except ValueError as error:
                    log("sim", "order", str(error))
                else:
                    self._shown, goes = False, True
                continue
            self._paused = order.do != "resume"
            goes = order.do != "pause"
        return goes

    def show(self, due_ns: int) -> None:
        """Publish the present state, which was due at `due_ns`, and wait for its answer."""
        observation = self._node.observation(time.monotonic_ns())
        self._answers.expect(observation, due_ns)
        self._bus.publish(OBSERVATION, observation)
        self._answers.put_ns = time.monotonic_ns()
        for event in self._node.take_events():
            self._bus.publish(EVENT, event)
        self._answer, self._shown = self._answers.wait(), True
        self._tell_of_strays()

    def _tell_of_strays(self) -> None:
        """Once a second: that somebody sends actions which are nobody's answer."""
        new, now_ns = self._answers.gate.strays - self._strays, time.monotonic_ns()
        if new and now_ns - self._strays_told_ns >= NS:
            self._strays, self._strays_told_ns = self._strays + new, now_ns
            detail = f"{new} stray actions are not carried out: of another world or tick, or a second answer"
            log("sim", "actuator", detail)
            self._bus.publish(
                EVENT,
                Event(
                    epoch=self._node.epoch,
                    stamp_ns=now_ns,
                    kind=EventKind.ACTUATOR,
                    node="sim",
                    tick=self._node.tick,
                    detail=detail,
                ),
            )

    def _step(self) -> None:
        self._node.advance(self._answer, time.monotonic_ns())
        self._shown = False

    def metrics(self) -> dict[str, float]:
        """What the heartbeat shows; called from its thread."""
        node, m = self._node, self._node.metrics
        gate = self._answers.gate
        (p50, p99), (age_p50, age_p99) = (
            np.percentile(np.array(ns.copy() or (0,)) / 1000.0, (50, 99)) for ns in (gate.round_trips_ns, gate.ages_ns)
        )
        return {
            "tick": node.tick, "epoch": node.epoch, "speed_mps": node.speed_mps, "lane": node.lane,
            "ticks": m.ticks, "answered": m.answered, "missed": gate.missed, "collisions": m.collisions,
            "rtt_p50_us": float(p50), "rtt_p99_us": float(p99),
            "age_p50_us": float(age_p50), "age_p99_us": float(age_p99),
            **{name: ns[-1] / 1000.0 for name, ns in (("rtt_us", gate.round_trips_ns), ("age_us", gate.ages_ns)) if ns},
            "skipped": self._schedule.skipped,
            "episodes": m.episodes, "holds": m.holds, "failsafes": m.failsafes, "passed": m.passed,
            "reached": m.reached, "struck": m.struck, "min_ttc_s": m.min_ttc_s,
            "seed": float(node.seed), "density": node.density,
            "paused": float(self._paused), "refused": m.refused, "strays": gate.strays,
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
    try:
        warm_up(config)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    node = SimNode(config)
    node.reset(time.monotonic_ns() // 1_000_000)  # grows at every restart, so old actions can never be taken for new
    node.announce("at the simulator's start", time.monotonic_ns())
    scheduling = claim(config.realtime)
    poll = may_poll(scheduling)
    with open_bus(config.bus) as bus:
        for topic in (OBSERVATION, EVENT, STATUS):
            bus.announce(topic)
        gate = Gate(round(config.budget_ms * 1e6))
        answers = Answers(bus.subscribe_rehearsed(ACTION, lambda _: None), gate, trace, poll)
        if bus.wait_for_reader(OBSERVATION, READER_S):
            time.sleep(SETTLE_S)
        schedule = Schedule(RehearsingClock(bus, poll), config.hz)
        loop = Loop(bus, node, answers, schedule)
        ticks = float("inf") if config.duration_s is None else config.duration_s * config.hz
        with Heartbeat(bus, "sim", loop.metrics) as heart:
            heart.epoch = node.epoch
            log("sim", "ready", epoch=node.epoch, scenario=config.scenario, seed=config.seed, realtime=scheduling)
            try:
                while node.metrics.ticks + schedule.skipped < ticks:
                    due_ns = schedule.wait()
                    heart.begin()
                    loop.tick(due_ns)
                    heart.epoch = node.epoch
                    heart.mode = (node.mode.name, node.mode.why, node.mode.since_ns)
                    heart.end()
                loop.show(schedule.wait())  # what the last step came to; nothing is done with the answer
            finally:
                heart.end()
                heart.state = "stopping"
                answers.closing = True
                trace.save()
                time.sleep(FAREWELL_S)


if __name__ == "__main__":
    sys.exit(run_node("sim", main))
