"""From slots to a directive: what the road does not allow is refused, and a speed is cut to the limit."""

from __future__ import annotations

from typing import Any

import pytest

from schemas.wire.messages import Directive, Lane
from slow_node.planning.directive import ASKS, ParseError, Refusal, directive_of, parse_answer
from slow_node.planning.replies import sentence
from slow_node.planning.scene import Scene, encode_scene
from slow_node.understanding.slots import Slots
from tests import scenes
from tests.ride import CANCEL, HURRY, LEFT, LIMIT, ONE_WAY, TWO_WAY, lane, ramp_ahead, scene
from tests.scenes import car


def two_way(lead_m: float = 25.0) -> Scene:
    """The two-way road, where 8 m/s are allowed: the ego in its own lane 1, a lead at 3.5 m/s."""
    return encode_scene(scenes.observation(car(0, 100, 1, 5), car(1, 100 + lead_m, 1, 3.5)))


def test_the_road_and_the_schema_are_gates() -> None:
    scene = two_way()
    faster = directive_of(Slots(outcome="directive", target_speed_mps=11.0), scene)
    assert isinstance(faster, Directive)
    assert faster.target_speed_mps == 8.0
    assert not isinstance(directive_of(Slots(outcome="directive", lane="right"), scene), Directive)
    with pytest.raises(ParseError, match="speed"):
        parse_answer('{"outcome":"directive","speed":"ludicrous"}')


def test_a_wish_to_overtake_says_so_where_nobody_slow_is_ahead() -> None:
    far = directive_of(Slots(outcome="directive", overtake=True), two_way(lead_m=160.0))
    near = directive_of(Slots(outcome="directive", overtake=True), two_way(lead_m=25.0))
    assert (far.say, near.say) == (
        sentence("nobody_ahead", "en", speed="29 km/h"),
        sentence("overtake", "en", lead="13 km/h"),
    )


def test_a_car_to_overtake_may_be_as_far_ahead_as_one_can_see() -> None:
    far = two_way(lead_m=120.0)
    asked = directive_of(Slots(outcome="directive", overtake=True), far)
    assert isinstance(asked, Directive)
    assert (asked.manoeuvre, asked.target_speed_mps) == ("overtake", 8.0)
    assert asked.say == sentence("overtake", "en", lead="13 km/h")
    hurry = directive_of(Slots(outcome="directive", speed="faster"), far)
    assert isinstance(hurry, Directive)
    assert hurry.manoeuvre == "cruise"


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
    assert directive_of(slots, scene(1)).say == (sentence(key, "de", speed="72 km/h") if key else "Gerne!")
