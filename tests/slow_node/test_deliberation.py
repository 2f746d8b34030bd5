"""Deliberation over time: what becomes of a wish after it was understood, and the gates before it is issued."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from schemas.runtime.clock import NS
from schemas.wire.messages import Command, Directive, Event, EventKind, Lane, Observation, Reason, Reply
from slow_node.deliberation import Deliberation, Effect, Interpret, Remember
from slow_node.interpreter import Interpretation
from slow_node.planning.directive import ASKS, Refusal, directive_of
from slow_node.planning.replies import SENTENCES, sentence
from slow_node.planning.scene import Scene, encode_scene
from slow_node.understanding.slots import Slots
from tests import scenes
from tests.scenes import car

LIMIT = 20.0
HURRY = Slots(outcome="directive", speed="faster", overtake=True, language="de")
CANCEL = Slots(outcome="directive", cancel=True, language="de")
LEFT = Slots(outcome="directive", lane="left")
Car = tuple[int, float, float]
"""Lane, distance ahead between centres [m], speed [m/s]."""
START_S = 100.0


def lane(direction: int = 1, kind: str = "main", start_m: float = -1e4, end_m: float = 1e4) -> Lane:
    return scenes.lane(oncoming=direction < 0, ramp=kind == "ramp", start_m=start_m, end_m=end_m, limit_mps=LIMIT)


ONE_WAY = (lane(), lane(), lane())
TWO_WAY = (lane(-1, "oncoming"), lane())


def seen(
    at_s: float, ego: int, *cars: Car, lanes: tuple[Lane, ...] = ONE_WAY, speed: float = 15.0, epoch: int = 1
) -> Observation:
    rows = [car(n, x, at, v) for n, (at, x, v) in enumerate(((ego, 0.0, speed), *cars))]
    return scenes.observation(*rows, lanes=lanes, epoch=epoch, stamp_ns=round(at_s * NS), tick=round(at_s * 15))


def scene(ego: int, *cars: Car, lanes: tuple[Lane, ...] = ONE_WAY, speed: float = 15.0) -> Scene:
    return encode_scene(seen(0.0, ego, *cars, lanes=lanes, speed=speed))


class Ride:
    """A deliberation with its time, and all that came out of it. Times in seconds."""

    def __init__(self, lanes: tuple[Lane, ...] = ONE_WAY) -> None:
        self.deliberation, self.lanes, self.now_s, self.said = Deliberation(), lanes, START_S, 0
        self.out: list[Effect] = []

    def look(self, ego: int, *cars: Car, after_s: float = 0.1, epoch: int = 1) -> list[Effect]:
        self.now_s += after_s
        observation = seen(self.now_s, ego, *cars, lanes=self.lanes, epoch=epoch)
        return self._keep(self.deliberation.on_scene(encode_scene(observation), self._now()))

    def hear(self, *, old_s: float = 0.0) -> list[Effect]:
        self.said += 1
        command = Command(epoch=1, stamp_ns=self._now() - round(old_s * NS), id=self.said, text=f"wish {self.said}")
        return self._keep(self.deliberation.on_command(command, self._now()))

    def say(self, slots: Slots | None, *, thinks_s: float = 0.0, reached: bool = True) -> list[Effect]:
        """A command that is understood so, or fails."""
        call = next(e for e in self.hear() if isinstance(e, Interpret))
        self.now_s += thinks_s
        return self._keep(self.deliberation.on_interpretation(call.id, Interpretation(slots, "", reached), self._now()))

    def tell(self, kind: str, rule: str | None = None, *, number: int = -1) -> list[Effect]:
        """The fast node reports about the newest directive, or the one of that number."""
        return self._keep(
            self.deliberation.on_event(
                Event(
                    epoch=1,
                    stamp_ns=self._now(),
                    kind=EventKind(kind),
                    node="fast",
                    tick=0,
                    rule=Reason(rule) if rule else None,
                    directive_id=self.directives[number].id,
                ),
                self._now(),
            )
        )

    def wait(self, seconds: int, ego: int, *cars: Car) -> list[Effect]:
        """So many seconds of the same scene, two scenes in each."""
        return [effect for _ in range(2 * seconds) for effect in self.look(ego, *cars, after_s=0.5)]

    @property
    def directives(self) -> list[Directive]:
        return [e for e in self.out if isinstance(e, Directive)]

    @property
    def replies(self) -> list[Reply]:
        return [e for e in self.out if isinstance(e, Reply)]

    @property
    def outcomes(self) -> list[str]:
        return [reply.outcome for reply in self.replies]

    @property
    def learnt(self) -> list[str]:
        return [e.outcome for e in self.out if isinstance(e, Remember)]

    def _now(self) -> int:
        return round(self.now_s * NS)

    def _keep(self, effects: list[Effect]) -> list[Effect]:
        self.out += effects
        return effects


def directives(effects: list[Effect]) -> list[Directive]:
    return [e for e in effects if isinstance(e, Directive)]


def riding(slots: Slots, ego: int, *cars: Car, lanes: tuple[Lane, ...] = ONE_WAY) -> Ride:
    """A ride on which this was just said."""
    ride = Ride(lanes)
    ride.look(ego, *cars)
    ride.say(slots)
    return ride


WISHES = {
    "faster": Slots(outcome="directive", speed="faster"),
    "speed": Slots(outcome="directive", target_speed_mps=10.0),
    "slower": Slots(outcome="directive", speed="slower"),
    "stop": Slots(outcome="directive", speed="stop"),
    "gap": Slots(outcome="directive", gap="farther"),
    "lane": LEFT,
    "stay": Slots(outcome="directive", overtake=False),
    "overtake": HURRY,
}


@pytest.mark.parametrize("slots", WISHES.values(), ids=WISHES.keys())
def test_any_wish_is_renewed_unchanged_before_its_time_to_live_ends(slots: Slots) -> None:
    ride = riding(slots, 1, (1, 40.0, 10.0))
    ride.wait(80, 1, (1, 40.0, 10.0))
    stamps = [d.stamp_ns / NS for d in ride.directives]
    assert len(stamps) == 3
    assert max(np.diff(stamps)) < ride.directives[0].ttl_s
    assert len({(d.manoeuvre, d.target_lane, d.target_speed_mps, d.headway_s) for d in ride.directives}) == 1


@pytest.mark.parametrize("slots", WISHES.values(), ids=WISHES.keys())
def test_a_wish_that_did_not_come_true_in_two_minutes_is_given_up_and_says_so(slots: Slots) -> None:
    ride = riding(slots, 1, (1, 40.0, 10.0))
    ride.wait(119, 1, (1, 40.0, 10.0))
    assert ride.outcomes == ["heard", "issued"]
    ride.wait(40, 1, (1, 40.0, 10.0))
    assert ride.outcomes == ["heard", "issued", "expired"]
    assert ride.replies[-1].say == sentence("expired", slots.language)
    assert ride.now_s - ride.directives[-1].stamp_ns / NS > ride.directives[-1].ttl_s


def test_a_directive_that_expired_all_the_same_is_renewed_by_the_next_scene() -> None:
    ride = riding(LEFT, 1)
    ride.now_s += 40.0
    ride.tell("expired")
    assert [d.target_lane for d in directives(ride.look(1))] == [0]


def test_a_wish_whose_lane_has_ended_is_renewed_without_it() -> None:
    ride = riding(LEFT, 1)
    ride.lanes = (lane(end_m=-10.0), lane(), lane())
    ride.wait(28, 1)
    assert [d.target_lane for d in ride.directives] == [0, None]


def test_a_wish_that_came_true_is_not_renewed_where_the_fast_node_keeps_it() -> None:
    ride = riding(LEFT, 1)
    ride.tell("fulfilled")
    assert ride.wait(60, 0) == []


def test_a_wished_gap_is_held_after_it_was_reached() -> None:
    ride = riding(WISHES["gap"], 1, (1, 40.0, 10.0))
    ride.tell("fulfilled")
    ride.tell("fulfilled")
    ride.wait(200, 1, (1, 40.0, 10.0))
    assert {(d.manoeuvre, d.headway_s) for d in ride.directives[1:]} == {("cruise", 3.0)}
    assert len(ride.directives) == 9
    assert ride.outcomes == ["heard", "issued", "fulfilled"]


# --- planning again ------------------------------------------------------------------------------------------------


def test_an_overtake_that_is_delayed_is_planned_again() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    assert [d.reasoning for d in directives(ride.tell("delayed", "rear gap in lane"))] == [
        "again: delayed by the fast system (rear gap in lane)"
    ]


def test_an_overtake_is_planned_again_when_its_lane_is_clear_again() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0), (0, 5.0, 15.0))
    assert ride.look(1, (1, 40.0, 10.0), (0, 6.0, 15.0)) == []
    assert [d.reasoning for d in directives(ride.look(1, (1, 40.0, 10.0)))] == ["again: lane 0 is clear again"]


def test_an_overtake_is_planned_again_when_its_car_is_passed() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    ride.look(0, (1, 2.0, 10.0))
    assert [d.reasoning for d in directives(ride.look(0, (1, -20.0, 10.0)))] == ["again: the car ahead is passed"]


def test_it_plans_again_at_most_once_in_three_seconds_and_forgets_nothing() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    for _ in range(20):
        ride.tell("delayed", "rear gap in lane")
        ride.look(1, (1, 40.0, 10.0))
    assert len(ride.directives) == 2
    ride.look(1, (1, 40.0, 10.0), after_s=3.0)
    assert len(ride.directives) == 3


def test_a_plan_that_stays_the_same_is_not_said_again() -> None:
    ride = riding(LEFT, 1)
    assert ride.tell("delayed", "rear gap in lane") == []
    assert ride.deliberation.figures["replans"] == 1


def test_a_hurry_overtakes_once_a_slow_car_is_ahead() -> None:
    ride = riding(WISHES["faster"], 1, lanes=TWO_WAY)
    assert [d.manoeuvre for d in directives(ride.look(1, (1, 40.0, 10.0)))] == ["overtake"]
    assert [d.manoeuvre for d in ride.directives] == ["cruise", "overtake"]


def test_while_it_faces_oncoming_traffic_nothing_but_the_way_home_is_asked_for() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0), lanes=TWO_WAY)
    ride.look(0, (1, 10.0, 10.0))
    assert ride.tell("delayed", "rear gap in lane") == []
    assert [d.target_lane for d in directives(ride.look(0, (1, -10.0, 10.0)))] == [1]
    assert ride.tell("delayed", "rear gap in lane") == []


def test_a_new_command_is_interpreted_with_what_is_being_delayed() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    ride.tell("delayed", "rear gap in lane")
    call = next(e for e in ride.hear() if isinstance(e, Interpret))
    assert (call.delayed, call.delayed_by) == ("overtake", "rear gap in lane")


def test_a_hurry_passes_the_second_slow_car_too_and_ends_on_its_own_side() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0), lanes=TWO_WAY)
    for _ in range(2):
        ride.look(0, (1, 10.0, 10.0), after_s=4.0)
        ride.look(0, (1, -10.0, 10.0), after_s=4.0)
        ride.look(1, (1, -20.0, 10.0), after_s=4.0)
        ride.tell("fulfilled")
        ride.look(1, (1, 60.0, 10.0), after_s=4.0)
    assert [(d.manoeuvre, d.target_lane) for d in ride.directives] == [("overtake", 0), ("overtake", 1)] * 2 + [
        ("overtake", 0)
    ]


def test_after_the_last_reply_a_hurry_goes_on_without_further_ones() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0), lanes=TWO_WAY)
    ride.tell("fulfilled")
    ride.look(1, (1, 60.0, 10.0), after_s=4.0)
    ride.tell("fulfilled")
    ride.wait(200, 1)
    assert len(ride.directives) > 5
    assert ride.outcomes == ["heard", "issued", "fulfilled"]
    assert ride.learnt == ["fulfilled"]


def test_a_wish_for_one_overtake_ends_with_it() -> None:
    ride = riding(Slots(outcome="directive", overtake=True), 1, (1, 40.0, 10.0))
    ride.tell("fulfilled")
    assert ride.wait(10, 0, (0, 40.0, 10.0)) == []


def passed_on_the_left(slots: Slots = HURRY) -> Ride:
    """One-way, over from lane 1 to lane 0 and past the slow car."""
    ride = riding(slots, 1, (1, 40.0, 10.0))
    ride.look(0, (1, -30.0, 10.0), after_s=4.0)
    ride.tell("fulfilled")
    return ride


def test_a_hurry_keeps_right_again_after_it_passed_on_the_left() -> None:
    ride = passed_on_the_left()
    ride.wait(10, 0, (1, -40.0, 10.0))
    assert [(d.manoeuvre, d.target_lane) for d in ride.directives[-2:]] == [("overtake", 0), ("cruise", 1)]
    ride.tell("fulfilled")
    assert ride.wait(10, 1) == []


@pytest.mark.parametrize("car", [(1, 85.0, 15.0), (1, -8.0, 20.0)], ids=["slower car ahead", "car beside"])
def test_a_hurry_stays_on_the_left_while_the_right_lane_is_not_free(car: Car) -> None:
    ride = passed_on_the_left()
    assert ride.wait(10, 0, car) == []


def test_a_hurry_that_was_asked_back_stays_where_a_slow_car_turns_up_on_the_right() -> None:
    ride = passed_on_the_left()
    ride.look(0, (1, -40.0, 10.0), after_s=4.0)
    ride.look(0, (1, 90.0, 10.0), after_s=4.0)
    assert [d.target_lane for d in ride.directives[-3:]] == [0, 1, None]


def test_a_hurry_does_not_go_farther_right_than_it_began() -> None:
    ride = riding(HURRY, 1)
    ride.tell("fulfilled")
    assert ride.wait(10, 1) == []


def test_in_a_new_world_the_wish_is_planned_anew() -> None:
    ride = riding(LEFT, 1)
    assert [d.target_lane for d in directives(ride.look(2, epoch=2))] == [1]


# --- the end of an intent ------------------------------------------------------------------------------------------


def test_never_mind_is_issued_and_fulfilled_at_once() -> None:
    ride = Ride()
    ride.look(1)
    assert [e.outcome for e in ride.say(CANCEL) if isinstance(e, Reply)] == ["issued", "fulfilled"]
    assert ride.wait(60, 1) == []


@pytest.mark.parametrize(("slots", "outcome"), [(CANCEL, "cancelled"), (LEFT, "superseded")])
def test_a_replaced_intent_says_so_in_its_own_language(slots: Slots, outcome: Any) -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    reply = next(e for e in ride.say(slots) if isinstance(e, Reply))
    assert (reply.command_id, reply.outcome, reply.say) == (1, outcome, sentence(outcome, "de"))


@pytest.mark.parametrize(("slots", "outcome"), [(CANCEL, "cancelled"), (LEFT, "superseded")])
def test_a_replaced_intent_is_learnt_where_it_was_held_up(slots: Slots, outcome: str) -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    ride.tell("delayed", "rear gap in lane")
    ride.say(slots)
    assert ride.learnt == [f"{outcome}, held up by rear gap in lane"]


def test_a_replaced_intent_that_nothing_held_up_teaches_nothing() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    ride.say(LEFT)
    assert ride.learnt == []


def test_a_replaced_intent_issues_nothing_more() -> None:
    ride = riding(HURRY, 1, (1, 40.0, 10.0))
    ride.say(Slots(outcome="directive", speed="slower"))
    ride.tell("delayed", "rear gap in lane", number=0)
    ride.wait(60, 1, (1, 40.0, 10.0))
    assert {d.manoeuvre for d in ride.directives[1:]} == {"cruise"}


def test_what_cannot_be_interpreted_is_said_in_the_language_last_spoken() -> None:
    ride = riding(HURRY, 1)
    ride.say(None, reached=False)
    ride.say(None)
    assert [r.say for r in ride.replies if r.outcome in ("failed", "refused")] == [
        sentence("failed", "de"),
        sentence("unclear", "de"),
    ]


def test_every_sentence_is_known_in_every_language() -> None:
    languages = SENTENCES["done"].keys()
    assert all(sentences.keys() == languages for sentences in SENTENCES.values())
    assert len(languages) == 7


# --- gates ---------------------------------------------------------------------------------------------------------


def test_without_a_recent_scene_a_command_is_refused_uninterpreted() -> None:
    ride = riding(HURRY, 1)
    ride.now_s += 10.1
    ride.hear()
    assert ride.outcomes[-2:] == ["heard", "refused"]
    assert ride.replies[-1].say == sentence("blind", "de")


def test_an_answer_to_a_scene_older_than_ten_seconds_is_refused() -> None:
    ride = Ride()
    ride.look(1)
    ride.say(LEFT, thinks_s=10.1)
    assert (ride.outcomes, ride.directives) == (["heard", "refused"], [])
    assert "too late" in ride.replies[-1].why


def test_the_road_is_checked_before_the_age_of_the_scene() -> None:
    ride = Ride()
    ride.look(0)
    ride.say(LEFT, thinks_s=10.1)
    assert ride.replies[-1].why == "no lane to the left"


def test_a_command_older_than_ten_seconds_is_refused_and_replaces_nothing() -> None:
    ride = Ride()
    ride.look(1)
    call = next(e for e in ride.hear() if isinstance(e, Interpret))
    ride.hear(old_s=10.1)
    ride.deliberation.on_interpretation(call.id, Interpretation(LEFT), ride._now())
    assert ride.outcomes == ["heard", "refused"]
    assert ride.replies[-1].why == "the command came 10 s late"


RAMP = (lane(), lane(), lane(kind="ramp"))
WORKS = (lane(), lane(), lane(end_m=100.0))
PAST_WORKS = (lane(), lane(), lane(end_m=-1.0))
WIDE = (lane(-1, "oncoming"), lane(-1, "oncoming"), lane(), lane())


@pytest.mark.parametrize(
    ("wish", "ego", "lanes", "expected"),
    [
        ("right", 1, RAMP, "no_lane"),
        ("rightmost", 0, RAMP, 1),
        ("keep", 2, RAMP, "no_lane"),
        ("left", 2, RAMP, 1),
        ("right", 1, WORKS, "no_lane"),
        ("rightmost", 0, WORKS, 1),
        ("right", 1, PAST_WORKS, "no_lane"),
        ("left", 1, WIDE, "oncoming"),
        ("left", 2, WIDE, "oncoming"),
        ("left", 0, WIDE, "no_lane"),
        ("right", 0, WIDE, 2),
        ("rightmost", 1, WIDE, 3),
        ("left", 3, WIDE, 2),
        ("left", 0, ONE_WAY, "no_lane"),
        ("right", 1, ONE_WAY, 2),
    ],
)
def test_a_wished_lane_is_one_to_drive_in_or_refused(
    wish: Any, ego: int, lanes: tuple[Lane, ...], expected: int | str
) -> None:
    plan = directive_of(Slots(outcome="directive", lane=wish), scene(ego, lanes=lanes))
    assert (plan.say if isinstance(plan, Refusal) else plan.target_lane) == (
        sentence(expected, "en") if isinstance(expected, str) else expected
    )


@pytest.mark.parametrize(
    "wish",
    [
        {"speed": "faster"},
        {"speed": "slower"},
        {"speed": "stop"},
        {"target_speed_mps": 29.0},
        {"target_speed_mps": 0.0},
    ],
    ids=str,
)
@pytest.mark.parametrize("speed", [0.0, 0.5, 15.0, 25.0])
def test_a_target_speed_lies_between_standstill_and_the_limit(wish: dict[str, Any], speed: float) -> None:
    plan = directive_of(Slots.model_validate({"outcome": "directive", **wish}), scene(1, speed=speed))
    assert isinstance(plan, Directive)
    assert plan.target_speed_mps is not None
    assert 0.0 <= plan.target_speed_mps <= (min(speed, LIMIT) if wish.get("speed") == "slower" else LIMIT)


@pytest.mark.parametrize(("speed", "kept"), [(0.0, None), (0.9, None), (1.0, 1.0), (15.0, 15.0), (25.0, LIMIT)])
def test_who_drives_keeps_the_speed_and_who_stands_goes_on_in_the_lane_as_before(
    speed: float, kept: float | None
) -> None:
    plan = directive_of(Slots(outcome="directive", speed="keep"), scene(1, speed=speed))
    assert isinstance(plan, Directive)
    assert (plan.target_speed_mps, plan.target_lane) == (kept, 1 if kept is None else None)


@pytest.mark.parametrize("ego", [0, 1])
def test_normal_again_names_nothing_in_a_borrowed_lane_either(ego: int) -> None:
    plan = directive_of(CANCEL, scene(ego, lanes=TWO_WAY))
    assert isinstance(plan, Directive)
    assert [getattr(plan, name) for name in ASKS] == ["cruise", None, None, None, "normal"]


def ramp_ahead(end_m: float) -> tuple[Lane, ...]:
    """Two lanes that go on, and a ramp that ends."""
    return (lane(), lane(), lane(kind="ramp", end_m=end_m))


def test_on_a_ramp_the_lane_to_go_on_in_is_the_one_beside_it() -> None:
    assert scene(2, lanes=ramp_ahead(100.0)).home_lane == 1


def test_on_a_ramp_the_lead_is_the_car_ahead_on_the_ramp() -> None:
    lead = scene(2, (1, 20.0, 15.0), (2, 40.0, 12.0), lanes=ramp_ahead(200.0)).lead
    assert lead is not None
    assert lead.id == 2


@pytest.mark.parametrize(
    ("slots", "expected"), [(LEFT, 1), (HURRY, 1), (Slots(outcome="directive", lane="keep"), None)]
)
def test_from_a_ramp_the_ego_is_sent_to_the_lane_beside_it_and_never_kept_on_it(
    slots: Slots, expected: int | None
) -> None:
    planned = directive_of(slots, scene(2, (2, 40.0, 10.0), lanes=ramp_ahead(200.0)))
    assert (planned.target_lane if isinstance(planned, Directive) else None) == expected


@pytest.mark.parametrize(("speed", "key"), [(25.0, "limit"), (20.0, None)])
def test_a_speed_cut_to_the_limit_is_said_to_be_whatever_the_model_says(speed: float, key: str | None) -> None:
    slots = Slots(outcome="directive", target_speed_mps=speed, say="Gerne!", language="de")
    assert directive_of(slots, scene(1)).say == (sentence(key, "de") if key else "Gerne!")
