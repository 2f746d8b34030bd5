"""Shows somebody's driver a road, another one and some nonsense, and keeps what it answers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec

from deploy.conform.verdict import NEWER, OTHER
from schemas.driving.road import HZ
from schemas.runtime.bus import Arrivals, ZenohBus
from schemas.runtime.clock import NS, MonotonicClock, Schedule
from schemas.wire import topics
from schemas.wire.codec import Fault, decode, encode
from schemas.wire.messages import Action, EventKind, Observation
from sim_node.config import SimConfig
from sim_node.node import SimNode

POLL_S = 0.0005
NONSENSE = (b"\xc1 no message", b"\x93\x01\x02\x03", b"", b"\x81\xa4type\xabobservation")


@dataclass
class Shown:
    """One observation and the answers that came until the next."""

    phase: str
    seen: Observation
    put_ns: int
    answers: list[tuple[Action, int]] = field(default_factory=list)
    """With their arrival [ns]."""

    def proper(self) -> list[tuple[Action, int]]:
        """Those that answer it."""
        return [(a, at) for a, at in self.answers if (a.epoch, a.answers_tick) == (self.seen.epoch, self.seen.tick)]


@dataclass
class Showing:
    """All that came of it."""

    budget_ns: int
    shown: list[Shown] = field(default_factory=list)
    unasked: list[Action] = field(default_factory=list)
    """While nothing was shown."""
    faults: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    """What the simulator's last check did not carry out."""
    came: bool = False
    """Any answer at all."""


SCRIPT = (("road", 60), ("newer", 8), ("nonsense", 10), ("world", 20), ("stands", 8), ("road", 8), ("other", 6))


class _Road:
    """The simulator, whose newest state is shown; what the driver says is heard."""

    def __init__(self, bus: ZenohBus, config: SimConfig, budget_ns: int) -> None:
        self.bus, self.showing = bus, Showing(budget_ns)
        self._ear: Arrivals = bus.subscribe_all(1000)
        self.sim = SimNode(config)
        self.epoch = time.monotonic_ns() // 1_000_000
        self.sim.reset(self.epoch)

    def hear(self, shown: Shown | None) -> None:
        for arrival in self._ear.take():
            if arrival.topic != topics.ACTION.name:
                continue
            at_ns, showing = time.monotonic_ns(), self.showing
            showing.came = True
            try:
                action = decode(topics.ACTION, arrival.payload)
            except Fault as fault:
                showing.faults.append(str(fault))
                continue
            if shown is None:
                showing.unasked.append(action)
            else:
                shown.answers.append((action, at_ns))

    def show(self, phase: str, schema: str | None = None) -> Shown:
        """Publish the present state, in the words of another version where one is named."""
        seen = self.sim.observation(time.monotonic_ns())
        payload = encode(seen)
        if schema is not None:
            words = msgspec.msgpack.decode(payload)
            payload = msgspec.msgpack.encode(words | {"schema": schema, "colour_of_the_sky": "blue", "moons": [1, 2]})
        shown = Shown(phase, seen, time.monotonic_ns())
        self.showing.shown.append(shown)
        self.bus.publish_bytes(topics.OBSERVATION, payload)
        return shown

    def until(self, due_ns: int, shown: Shown | None) -> None:
        """Hear what comes until then."""
        while time.monotonic_ns() < due_ns:
            time.sleep(POLL_S)
            self.hear(shown)

    def step(self, shown: Shown) -> None:
        """On, with the answer that came in time."""
        answer = next((a for a, at in shown.proper()[:1] if at - shown.put_ns <= self.showing.budget_ns), None)
        self.sim.advance(answer, time.monotonic_ns())
        self.showing.refused += [e.detail for e in self.sim.take_events() if e.kind == EventKind.ACTUATOR]


def show(
    bus: ZenohBus, budget_ns: int, first_s: float, config: SimConfig, alive: Callable[[], bool] = lambda: True
) -> Showing:
    """Show the driver that is on the bus the script. first_s: how long its first answer may take; alive: whether its
    process still runs."""
    road = _Road(bus, config, budget_ns)
    bus.announce(topics.OBSERVATION)
    give_up_s = time.monotonic() + first_s
    while not road.showing.came and time.monotonic() < give_up_s and alive():  # the first one, again and again
        waiting = road.show("wait")
        road.until(time.monotonic_ns() + NS // HZ, waiting)
    road.showing.shown.clear()
    road.showing.faults.clear()
    if not road.showing.came:
        return road.showing
    road.epoch += 1
    road.sim.reset(road.epoch)
    schedule = Schedule(MonotonicClock(), HZ)
    for phase, ticks in SCRIPT:
        if phase == "world":
            road.epoch += 1
            road.sim.reset(road.epoch)
        for k in range(ticks):
            due_ns = schedule.wait() + NS // HZ
            if phase == "stands":
                road.until(due_ns, None)
                continue
            shown = road.show(phase, {"newer": NEWER, "other": OTHER}.get(phase))
            if phase == "nonsense":
                road.until(due_ns - NS // HZ // 2, shown)
                bus.publish_bytes(topics.OBSERVATION, NONSENSE[k % len(NONSENSE)])
            road.until(due_ns, shown)
            road.step(shown)
    return road.showing
