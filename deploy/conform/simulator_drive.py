"""Drives somebody's simulator, well and badly, and keeps what it shows and what it was told."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import msgspec

from deploy.conform.verdict import OTHER
from schemas.runtime.bus import Arrivals, ZenohBus
from schemas.runtime.clock import NS
from schemas.wire import topics
from schemas.wire.codec import Fault, decode, encode
from schemas.wire.messages import Action, Control, Event, MetaAction, Observation

POLL_S = 0.0005
GIVE_UP_S = 3.0
"""A simulator that shows nothing for so long has stopped."""
LATE_NS = 15_000_000
"""So much after the budget a late answer leaves."""
SHORT_NS, SHORT_LATE_NS = 2_000_000, 9_000_000
"""A budget that an action states, and when that action leaves."""
END_TICKS = 300
"""So long a crash is waited for where the simulator obeys no `restart`."""


class Sent(NamedTuple):
    """One payload of ours."""

    payload: bytes
    after_ns: int = 0
    """From the observation's arrival."""
    action: Action | None = None
    """The answer that it is; None: something that must have no effect."""


@dataclass
class Step:
    """One observation and what was said to it."""

    phase: str
    seen: Observation
    arrived_ns: int
    sent: list[Sent] = field(default_factory=list)
    prompt: bool = True
    """Its answer left within a quarter of the budget."""

    @property
    def answer(self) -> Action | None:
        """The one that is to be applied."""
        return next((s.action for s in self.sent if s.action is not None), None)


@dataclass
class Drive:
    """All that came of it."""

    budget_ns: int
    steps: list[Step] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    """Why a payload of the simulator's could not be read."""
    stopped: str = ""
    """In which phase it fell silent; "": it did not."""


Say = Callable[[Observation, int], list[Sent]]
"""What is said to an observation, the k-th of its phase."""


def _action(seen: Observation, meta: MetaAction, **fields: object) -> Action:
    action = Action(
        epoch=seen.epoch, stamp_ns=time.monotonic_ns(), answers_tick=seen.tick, meta_action=int(meta), source="policy"
    )
    return msgspec.structs.replace(action, **fields)


def _says(action: Action, after_ns: int = 0) -> Sent:
    return Sent(encode(action), after_ns, action)


def _without_effect(action: Action, after_ns: int = 0) -> Sent:
    return Sent(encode(action), after_ns)


def _hold(seen: Observation, k: int) -> list[Sent]:
    return [_says(_action(seen, MetaAction.CRUISE))]


def _faster(seen: Observation, k: int) -> list[Sent]:
    return [_says(_action(seen, MetaAction.SPEED_UP))]


def _slower(seen: Observation, k: int) -> list[Sent]:
    return [_says(_action(seen, MetaAction.SLOW_DOWN))]


def _brake(seen: Observation, k: int) -> list[Sent]:
    return [_says(_action(seen, MetaAction.EMERGENCY_BRAKE))]


def _to_the_goal(seen: Observation, k: int) -> list[Sent]:
    return [_says(_action(seen, MetaAction.SPEED_UP, speed_goal_mps=seen.target_speed_mps + 0.04))]


class _Capped:
    """CRUISE under a speed cap well below the speed."""

    def __init__(self) -> None:
        self.cap_mps = -1.0

    def __call__(self, seen: Observation, k: int) -> list[Sent]:
        if self.cap_mps < 0.0:
            self.cap_mps = max(memoryview(seen.rows).cast("f")[3] - 3.0, 1.0)
        return [_says(_action(seen, MetaAction.CRUISE, speed_cap_mps=self.cap_mps))]


def _change(seen: Observation, k: int) -> list[Sent]:
    """One lane change to whichever side has a lane; then held until it is over."""
    metas = (MetaAction.RIGHT, MetaAction.LEFT)
    if k < 20 and seen.previous_lane < 0 and k % 5 == 0:
        return [_says(_action(seen, metas[k // 5 % 2]))]
    return _hold(seen, k)


class _Strays:
    """Before or after a good CRUISE something that is nobody's answer, all within a quarter of the budget."""

    def __init__(self, budget_ns: int) -> None:
        self._good_ns, self._second_ns = budget_ns // 10, budget_ns // 5

    def __call__(self, seen: Observation, k: int) -> list[Sent]:
        up = _action(seen, MetaAction.SPEED_UP)
        other = [
            _without_effect(msgspec.structs.replace(up, epoch=seen.epoch + 1)),
            _without_effect(msgspec.structs.replace(up, answers_tick=seen.tick - 1)),
            _without_effect(msgspec.structs.replace(up, answers_tick=seen.tick + 1)),
            _without_effect(msgspec.structs.replace(up, meta_action=9)),
            _without_effect(msgspec.structs.replace(up, schema=OTHER)),
            Sent(b"\xc1 no message"),
            Sent(b"\x93\x01\x02\x03"),
        ]
        good = _says(_action(seen, MetaAction.CRUISE), self._good_ns)
        if k % 8 == 7:
            return [good, _without_effect(up, self._second_ns)]
        return [other[k % 8], good]


class _Late:
    """Every other answer comes after the budget: the simulator's, or the action's own."""

    def __init__(self, after_ns: int, budget_ns: int = 0) -> None:
        self._after_ns, self._budget_ns = after_ns, budget_ns

    def __call__(self, seen: Observation, k: int) -> list[Sent]:
        if k % 2:
            return _hold(seen, k)
        return [_without_effect(_action(seen, MetaAction.SPEED_UP, budget_ns=self._budget_ns), self._after_ns)]


def _nothing(seen: Observation, k: int) -> list[Sent]:
    return []


def script(budget_ns: int) -> list[tuple[str, int, Say]]:
    """The phases: name, ticks, what is said."""
    return [
        ("hold", 15, _hold),
        ("slower", 8, _slower),
        ("faster", 12, _faster),
        ("goal", 2, _to_the_goal),
        ("cap", 25, _Capped()),
        ("faster", 15, _faster),
        ("change", 60, _change),
        ("strays", 16, _Strays(budget_ns)),
        ("late", 10, _Late(budget_ns + LATE_NS)),
        ("short", 10, _Late(SHORT_LATE_NS, SHORT_NS)),
        ("faster", 15, _faster),
        ("brake", 4, _brake),
        ("faster", 15, _faster),
        ("silence", 18, _nothing),
        ("hold", 4, _hold),
        ("restart", 15, _hold),
    ]


def drive(bus: ZenohBus, budget_ns: int, first_s: float, alive: Callable[[], bool] = lambda: True) -> Drive:
    """Drive the simulator that is on the bus through the script. first_s: how long its first observation may take;
    alive: whether its process still runs."""
    ear = _Ear(bus, Drive(budget_ns), alive)
    bus.announce(topics.ACTION)
    shown = ear.observations(first_s)
    for phase, ticks, say in script(budget_ns):
        if phase == "restart" and not ear.drive.stopped and ear.drive.steps:
            _order_restart(bus, ear.drive.steps[-1].seen.epoch)
        _play(bus, ear.drive, shown, phase, ticks, say)
        shown = ear.observations(GIVE_UP_S)
    worlds = {step.seen.epoch for step in ear.drive.steps}
    if len(worlds) == 1 and not ear.drive.stopped:
        _play(bus, ear.drive, shown, "end", END_TICKS, _faster, until_new_world=True)
    time.sleep(0.2)  # the event of a new world may still be on its way
    ear.hear()
    return ear.drive


def _order_restart(bus: ZenohBus, epoch: int) -> None:
    bus.publish(topics.CONTROL, Control(epoch=epoch, stamp_ns=time.monotonic_ns(), do="restart"))


def _play(
    bus: ZenohBus,
    drive: Drive,
    shown: Iterator[tuple[Observation, int]],
    phase: str,
    ticks: int,
    say: Say,
    *,
    until_new_world: bool = False,
) -> None:
    if drive.stopped:
        return
    for k in range(ticks):
        came = next(shown, None)
        if came is None:
            drive.stopped = phase
            return
        step = Step(phase, *came)
        drive.steps.append(step)
        if until_new_world and step.seen.epoch != drive.steps[0].seen.epoch:
            return
        for sent in say(step.seen, k):
            left_ns = step.arrived_ns + sent.after_ns - time.monotonic_ns()
            if left_ns > 0:
                time.sleep(left_ns / NS)
            bus.publish_bytes(topics.ACTION, sent.payload)
            step.sent.append(sent._replace(after_ns=time.monotonic_ns() - step.arrived_ns))
        step.prompt = all(s.after_ns < drive.budget_ns // 4 for s in step.sent)


class _Ear:
    """Hears all that the simulator says."""

    def __init__(self, bus: ZenohBus, drive: Drive, alive: Callable[[], bool]) -> None:
        self._said: Arrivals = bus.subscribe_all(1000)
        self.drive, self._alive = drive, alive
        self._waiting: list[tuple[Observation, int]] = []

    def hear(self) -> None:
        for arrival in self._said.take():
            now_ns = time.monotonic_ns()
            try:
                if arrival.topic == topics.OBSERVATION.name:
                    self._waiting.append((decode(topics.OBSERVATION, arrival.payload), now_ns))
                elif arrival.topic == topics.EVENT.name:
                    self.drive.events.append(decode(topics.EVENT, arrival.payload))
            except Fault as fault:
                self.drive.faults.append(f"{arrival.topic}: {fault}")

    def observations(self, silent_s: float) -> Iterator[tuple[Observation, int]]:
        """The newest observation, as soon as it is there, again and again; ends after `silent_s` without any."""
        until = time.monotonic() + silent_s
        while time.monotonic() < until and self._alive():
            self.hear()
            if self._waiting:
                newest = self._waiting[-1]
                self._waiting.clear()
                yield newest
                until = time.monotonic() + silent_s
            else:
                time.sleep(POLL_S)
