"""A drive of a good simulator keeps every duty; with one thing spoilt, that duty does not hold and says why."""

from __future__ import annotations

import functools
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from deploy.conform.simulator_drive import Drive, Step, script
from deploy.conform.simulator_duties import duties
from deploy.conform.verdict import Duty, all_hold, table
from schemas.driving.road import HZ, ID, VX
from schemas.runtime.clock import NS
from schemas.wire.codec import rows_of
from schemas.wire.messages import Control, Event, EventKind, Observation
from sim_node.config import SimConfig
from sim_node.gate import Gate
from sim_node.node import SimNode

BUDGET_NS = 20_000_000


@functools.cache
def _driven(budget_ns: int = BUDGET_NS) -> Drive:
    """Our own simulator, in lock-step: what it shows at each tick of the script, and what it is told."""
    sim, drive, now_ns = SimNode(SimConfig(scenario="highway", seed=3)), Drive(budget_ns), NS
    sim.reset(1)
    for phase, ticks, say in script(budget_ns):
        if phase == "restart":
            sim.restart(Control(epoch=0, stamp_ns=now_ns, do="restart"), now_ns)
        for k in range(ticks):
            step = Step(phase, sim.observation(now_ns), now_ns + 500_000)
            step.sent = say(step.seen, k)
            step.prompt = all(sent.after_ns < budget_ns // 4 for sent in step.sent)
            drive.steps.append(step)
            gate = Gate(budget_ns)
            gate.open(step.seen.epoch, step.seen.tick, now_ns)
            for sent in step.sent:
                try:
                    action = msgspec.msgpack.decode(sent.payload, type=type(step.answer or sent.action))
                except msgspec.DecodeError:
                    continue
                if action is not None and action.schema.startswith("3"):
                    gate.arrived(action, now_ns + sent.after_ns)
            sim.advance(gate.close(now_ns + budget_ns), now_ns)
            drive.events += sim.take_events()
            now_ns += NS // HZ
    return drive


def _judged(spoil: Callable[[Drive], object] = lambda drive: None) -> dict[str, Duty]:
    drive = deepcopy(_driven())
    spoil(drive)
    return {duty.name: duty for duty in duties(drive)}


def _each(change: Callable[[Step], Observation]) -> Callable[[Drive], None]:
    def spoil(drive: Drive) -> None:
        for step in drive.steps:
            step.seen = change(step)

    return spoil


def _fields(**fields: object) -> Callable[[Drive], None]:
    return _each(lambda step: msgspec.structs.replace(step.seen, **fields))


def _rows(change: Callable[[np.ndarray], None]) -> Callable[[Drive], None]:
    def changed(step: Step) -> Observation:
        rows = rows_of(step.seen).copy()
        change(rows)
        return msgspec.structs.replace(step.seen, rows=rows.tobytes())

    return _each(changed)


def _kmh(rows: np.ndarray) -> None:
    rows[:, VX] *= 3.6


def _same_id(rows: np.ndarray) -> None:
    rows[1:, ID] = 5.0


def _wanders(rows: np.ndarray) -> None:
    rows[1:, ID] = 1 + np.roll(np.arange(len(rows) - 1), round(float(rows[0, 1])) % 3)


def test_our_own_simulator_keeps_every_duty() -> None:
    found = _judged()
    assert all_hold(list(found.values())), table(list(found.values()))


SPOILT: dict[str, tuple[str, Callable[[Drive], object], str]] = {
    "another rate": ("rate", _fields(hz=10), "hz says 10"),
    "half of the rate": (
        "rate",
        lambda d: d.steps.__setitem__(slice(None), [replace(s, arrived_ns=2 * s.arrived_ns) for s in d.steps]),
        "7.5 observations a second",
    ),
    "wall clock": (
        "stamps",
        _each(lambda s: msgspec.structs.replace(s.seen, stamp_ns=s.seen.stamp_ns + 10**18)),
        "ahead of CLOCK_MONOTONIC",
    ),
    "old stamps": (
        "stamps",
        _each(lambda s: msgspec.structs.replace(s.seen, stamp_ns=s.seen.stamp_ns - NS)),
        "old on arrival",
    ),
    "one stamp for all": ("stamps", _fields(stamp_ns=10**9), "old on arrival"),
    "km/h": ("units", _rows(_kmh), "m/s and m are asked for"),
    "no acceleration": (
        "units",
        _each(lambda s: msgspec.structs.replace(s.seen, acceleration_mps2=s.seen.acceleration_mps2 + 9.81)),
        "acceleration_mps2 is off by 9.8",
    ),
    "an ego with another id": ("ids", _rows(lambda r: r[0].__setitem__(ID, 7.0)), "it is the ego's, which is 0"),
    "one id for all": ("ids", _rows(_same_id), "two cars have one id"),
    "ids that wander": ("ids", _rows(_wanders), "an id stays with its car"),
    "ticks that stand": ("ticks", _fields(tick=5), "one more each time"),
    "a smaller epoch": ("epochs", _each(lambda s: msgspec.structs.replace(s.seen, epoch=-s.seen.epoch)), "a greater"),
    "no new world": ("epochs", lambda d: d.steps.__delitem__(slice(-15, None)), "no new world came"),
    "an unannounced world": ("epochs", lambda d: d.events.clear(), "no event of kind `world`"),
    "a late start": (
        "epochs",
        _each(lambda s: msgspec.structs.replace(s.seen, tick=s.seen.tick + 9)),
        "began at tick 9",
    ),
    "on after a crash": ("epochs", _fields(crashed=True), "went on after a crash"),
    "no answer applied": ("answers", _fields(applied_tick=-1), "were not applied"),
    "a speed that never steps": ("set-points", _fields(target_speed_mps=20.0), "never rose"),
    "steps of a metre": (
        "set-points",
        _each(lambda s: msgspec.structs.replace(s.seen, target_speed_mps=10 * s.seen.target_speed_mps)),
        "0.1 m/s less is asked for",
    ),
    "a lane that never changes": (
        "lane changes",
        lambda d: _fields(target_lane=1)(_without_events(d)),
        "never changed target_lane",
    ),
    "a change without end": ("lane changes", _each(lambda s: _always_changing(s)), "was not over"),
    "no brake": ("speeds", _fields(acceleration_mps2=-1.0), "as hard as the car can"),
    "unread": ("readable", lambda d: d.faults.append("observation: 5000 bytes exceed 3072"), "5000 bytes"),
    "silent": ("keeps going", lambda d: setattr(d, "stopped", "strays"), "in the phase 'strays'"),
}


def _without_events(drive: Drive) -> Drive:
    drive.events.clear()
    return drive


def _always_changing(step: Step) -> Observation:
    return msgspec.structs.replace(step.seen, previous_lane=max(step.seen.previous_lane, 0))


@pytest.mark.parametrize("name", SPOILT)
def test_a_simulator_that_spoils_one_thing_is_told_of_it(name: str) -> None:
    duty, spoil, says = SPOILT[name]
    found = _judged(spoil)[duty]
    assert not found.holds
    assert says in found.found


def _spoil_pairs(phase: str, **fields: object) -> Callable[[Drive], None]:
    """What is shown after each tick of a phase."""

    def spoil(drive: Drive) -> None:
        for before, after in zip(drive.steps, drive.steps[1:], strict=False):
            if before.phase == phase:
                told = {k: v(before, after) if callable(v) else v for k, v in fields.items()}
                after.seen = msgspec.structs.replace(after.seen, **told)

    return spoil


def test_a_simulator_that_takes_what_is_no_answer_is_told_of_it() -> None:
    found = _judged(_spoil_pairs("strays", target_speed_mps=lambda a, b: a.seen.target_speed_mps + 0.1))["strays"]
    assert "was carried out" in found.found


def test_strays_that_could_not_be_tried_in_time_tell_nothing() -> None:
    def slow(drive: Drive) -> None:
        for step in drive.steps:
            step.prompt = step.prompt and step.phase != "strays"

    assert "no stray could be tried" in _judged(slow)["strays"].found


def test_a_small_budget_lets_every_stray_be_tried_all_the_same() -> None:
    found = {duty.name: duty.found for duty in duties(_driven(8_000_000))}
    assert found["strays"] == "16 without effect"


@pytest.mark.parametrize("phase", ["late", "short"])
def test_a_simulator_that_takes_a_late_answer_is_told_of_it(phase: str) -> None:
    found = _judged(_spoil_pairs(phase, applied_tick=lambda a, b: a.seen.tick))["budget"]
    assert not found.holds


def test_a_brake_that_is_never_applied_is_no_brake() -> None:
    assert "no 'emergency brake' was applied" in _judged(_spoil_pairs("brake", applied_tick=-1))["speeds"].found


@pytest.mark.parametrize("phase", ["late", "short"])
def test_a_budget_that_no_late_answer_tried_is_not_kept(phase: str) -> None:
    def untried(drive: Drive) -> None:
        drive.steps = [step for step in drive.steps if step.phase != phase or step.answer is not None]

    assert "could be tried" in _judged(untried)["budget"].found


def test_a_simulator_that_drives_on_without_answers_is_told_of_it() -> None:
    def keep_speed(drive: Drive) -> None:
        first = next(rows_of(s.seen)[0, VX] for s in drive.steps if s.phase == "silence")
        for step in drive.steps:
            if step.phase in ("silence", "hold"):
                rows = rows_of(step.seen).copy()
                rows[0, VX] = first
                step.seen = msgspec.structs.replace(step.seen, rows=rows.tobytes())

    assert "does not brake" in _judged(keep_speed)["silence"].found


def test_a_lane_change_that_the_simulator_says_it_has_stopped_is_no_fault() -> None:
    def refuse(drive: Drive) -> None:
        _fields(target_lane=1, previous_lane=-1)(drive)
        first = next(step.seen for step in drive.steps if step.phase == "change")
        why = {"kind": EventKind.ACTUATOR, "node": "sim", "detail": "the place is taken"}
        drive.events.append(Event(epoch=first.epoch, stamp_ns=0, tick=first.tick + 1, **why))  # type: ignore[arg-type]

    assert _judged(refuse)["lane changes"].holds


def test_nothing_at_all_keeps_no_duty() -> None:
    assert not any(duty.holds for duty in duties(Drive(BUDGET_NS)) if duty.name != "keeps going")


def test_the_duty_names_the_budget_that_it_is_tried_with() -> None:
    budget = next(duty for duty in duties(Drive(30_000_000)) if duty.name == "budget")
    assert budget.asks == "what comes after 30 ms, or after the action's own budget_ns, is not applied"
