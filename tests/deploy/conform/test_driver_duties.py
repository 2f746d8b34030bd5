"""A good driver keeps every duty; with one thing spoilt, that duty does not hold and says why."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from deploy.conform.driver_drive import SCRIPT, Showing, Shown
from deploy.conform.driver_duties import duties
from deploy.conform.verdict import Duty, all_hold, as_data
from schemas.driving.road import HZ
from schemas.runtime.clock import NS
from schemas.wire.messages import Action, Closure, Reason
from tests.scenes import car, observation


def _showing() -> Showing:
    """Everything is answered as it should be."""
    showing, epoch, tick, now_ns = Showing(20_000_000, came=True), 1, 0, NS
    for phase, ticks in SCRIPT:
        if phase == "world":
            epoch, tick = 2, 0
        for _ in range(ticks):
            now_ns += NS // HZ
            if phase == "stands":
                continue
            seen = msgspec.structs.replace(observation(car(0, 500, 1, 5)), epoch=epoch, tick=tick, stamp_ns=now_ns)
            shown = Shown(phase, seen, now_ns)
            if phase != "other":
                answer = Action(
                    epoch=epoch, stamp_ns=now_ns + 900_000, answers_tick=tick, meta_action=1, source="policy",
                    closed=(Closure(action=3, reason=Reason.NO_LANE),),
                )  # fmt: skip
                shown.answers.append((answer, now_ns + 1_000_000))
            showing.shown.append(shown)
            tick += 1
    return showing


def _judged(spoil: Callable[[Showing], object] = lambda showing: None) -> dict[str, Duty]:
    showing = _showing()
    spoil(showing)
    return {duty.name: duty for duty in duties(showing)}


def _answers(phases: tuple[str, ...] = (), later_ns: int = 0, **fields: object) -> Callable[[Showing], None]:
    """Every answer otherwise."""

    def spoil(showing: Showing) -> None:
        for shown in showing.shown:
            if not phases or shown.phase in phases:
                shown.answers[:] = [
                    (
                        msgspec.structs.replace(a, **{k: v(a) if callable(v) else v for k, v in fields.items()}),
                        at + later_ns,
                    )
                    for a, at in shown.answers
                ]

    return spoil


def _unanswered(phase: str) -> Callable[[Showing], None]:
    def spoil(showing: Showing) -> None:
        for shown in showing.shown:
            if shown.phase == phase:
                shown.answers.clear()

    return spoil


def _twice(showing: Showing) -> None:
    for shown in showing.shown:
        shown.answers *= 2


def _answer_other(showing: Showing) -> None:
    for shown in showing.shown:
        if shown.phase == "other":
            seen = shown.seen
            action = Action(epoch=seen.epoch, stamp_ns=0, answers_tick=seen.tick, meta_action=1, source="policy")
            shown.answers.append((action, 0))


def test_a_good_driver_keeps_every_duty() -> None:
    found = list(_judged().values())
    assert all_hold(found)
    assert as_data("driver", found)["conforms"]


SPOILT: dict[str, tuple[str, Callable[[Showing], object], str]] = {
    "another tick": ("each tick", _answers(answers_tick=lambda a: a.answers_tick + 1), "answers_tick"),
    "half of the ticks": ("each tick", _unanswered("road"), "0 of 68"),
    "twice": ("once", _twice, "answered twice"),
    "unasked": ("once", lambda s: s.unasked.extend([s.shown[0].answers[0][0]] * 2), "while nothing was shown"),
    "late": ("late", _answers(later_ns=30_000_000), "answers came after 20 ms"),
    "the old epoch": ("epochs", _answers(("world",), epoch=1), "answers of epoch 1 came"),
    "wall clock": ("stamps", _answers(stamp_ns=1_790_000_000 * NS), "ahead of CLOCK_MONOTONIC"),
    "no stamp": ("stamps", _answers(stamp_ns=0), "older than what they answer"),
    "a closed action": ("closed", _answers(meta_action=3), "which it closes: no lane there"),
    "what must be stopped": ("carried out", lambda s: s.refused.append("left: the place is taken"), "place is taken"),
    "a newer minor": ("newer minor", _unanswered("newer"), "0 of 8"),
    "nonsense": ("nonsense", _unanswered("nonsense"), "0 of 9"),
    "another major": ("other major", _answer_other, "refuse another major"),
    "unread": ("readable", lambda s: s.faults.append("meta_action 9 is not within 0..5"), "meta_action 9"),
}


@pytest.mark.parametrize("name", SPOILT)
def test_a_driver_that_spoils_one_thing_is_told_of_it(name: str) -> None:
    duty, spoil, says = SPOILT[name]
    found = _judged(spoil)[duty]
    assert not found.holds
    assert says in found.found


def test_nothing_at_all_keeps_no_duty() -> None:
    assert not any(duty.holds for duty in duties(Showing(20_000_000)))


def test_the_duty_names_the_budget_that_it_is_tried_with() -> None:
    late = next(duty for duty in duties(Showing(7_500_000)) if duty.name == "late")
    assert late.asks == "within 7.5 ms of the publication"
