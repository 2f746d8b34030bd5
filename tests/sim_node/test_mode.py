"""The mode: when the car counts as well driven, and what is said where it does not."""

from __future__ import annotations

from schemas.wire.messages import Action
from sim_node.config import SimConfig
from sim_node.mode import GOOD_TICKS, ModeKeeper
from sim_node.node import SimNode


def answer(source: str = "policy", why: str = "", tick: int = 0) -> Action:
    return Action(epoch=1, stamp_ns=0, answers_tick=tick, meta_action=1, source=source, why=why)  # type: ignore[arg-type]


def fed(*answers: Action | None) -> ModeKeeper:
    keeper = ModeKeeper()
    for at, action in enumerate(answers, 1):
        keeper.tick(action, False, 10.0, at)
    return keeper


def test_a_few_ticks_without_the_policy_are_no_matter_five_within_a_second_are() -> None:
    assert fed(*[None] * 4, *[answer()] * 11).name == "NOMINAL"
    poor = fed(answer(), *[answer("fallback", "TimeoutError: late")] * 5)
    assert (poor.name, poor.why, poor.since_ns) == ("DEGRADED", "TimeoutError: late", 6)
    assert fed(*[None] * 5).why == "no answer in time"
    assert fed(*[answer("fallback")] * 5).why == "the fallback drives"


def test_thirty_good_ticks_on_end_and_all_is_well_again() -> None:
    assert fed(*[None] * 5, *[answer()] * (GOOD_TICKS - 1)).name == "DEGRADED"
    well = fed(*[None] * 5, *[answer()] * GOOD_TICKS)
    assert (well.name, well.why) == ("NOMINAL", "")


def test_a_car_that_nobody_answers_for_is_stopped_stands_and_comes_back_degraded() -> None:
    sim = SimNode(SimConfig(scenario="two-way", seed=0))
    sim.reset(1)
    names = []
    for _ in range(150):
        sim.step(None, sim.tick)
        names.append(sim.mode.name)
    assert list(dict.fromkeys(names)) == ["NOMINAL", "FAIL-SAFE", "STOPPED"]
    sim.step(answer(tick=sim.tick), 1000)
    assert (sim.mode.name, sim.mode.since_ns) == ("DEGRADED", 1000)
