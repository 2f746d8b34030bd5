"""The scene: what the slow node knows of the road, and how it is described in words."""

from __future__ import annotations

from schemas.wire.messages import Lane
from slow_node.planning.scene import describe, encode_scene
from tests import scenes
from tests.ride import ramp_ahead, scene
from tests.scenes import car

HIGHWAY = tuple(scenes.lane(k, start_m=-1e4, limit_mps=33) for k in range(4))
ROUND = ((45, 1, 20), (30, 0, 24), (60, 0, 24), (-30, 0, 28), (-25, 2, 22), (4, 2, 25), (50, 3, 25))
"""Cars around an ego at x 0 in lane 1 at 25 m/s: centre [m], lane, speed [m/s]."""


def described(
    lanes: tuple[Lane, ...] = HIGHWAY,
    cars: tuple[tuple[float, int, float], ...] = (),
    lane: int = 1,
    delayed_by: str = "",
) -> str:
    rows = [car(i, *where) for i, where in enumerate(((0, lane, 25), *cars))]
    return describe(encode_scene(scenes.observation(*rows, lanes=lanes)), delayed_by)


def test_an_empty_road_is_described_by_its_lanes() -> None:
    assert described() == ("one-way road, lanes 0-3, we are in 1; 25 of 33 m/s; no car ahead; free lanes 0, 1, 2, 3")


def test_the_nearest_cars_ahead_and_behind_in_each_lane_beside_are_described_with_gaps_and_closing_speeds() -> None:
    assert described(cars=ROUND) == (
        "one-way road, lanes 0-3, we are in 1; 25 of 33 m/s; car ahead 40 m at 20.0 m/s, closing 5; right beside us; "
        "right behind 20 m, closing -3; left ahead 25 m, closing 1; left behind 25 m, closing 3; free lanes 0, 1, 3"
    )


def test_an_oncoming_car_is_described_once_with_the_speed_of_both() -> None:
    lanes = (scenes.lane(0, start_m=-1e4, oncoming=True), scenes.lane(1, start_m=-1e4))
    assert described(lanes, ((65, 0, -20),)).endswith(
        "no car ahead; oncoming car 60 m, closing 45; free lanes 0, 1; lane 0 is oncoming"
    )


def test_a_ramp_that_ends_is_described_as_such() -> None:
    lanes = (*HIGHWAY[:2], scenes.lane(2, start_m=-100, end_m=120, ramp=True))
    assert described(lanes, lane=2).endswith("; lane 2 is a ramp; our lane ends in 120 m")


def test_what_was_just_delayed_is_described_with_its_rule() -> None:
    assert described(delayed_by="rear gap in lane").endswith("; just delayed: rear gap in lane")


def test_on_a_ramp_the_lane_to_go_on_in_is_the_one_beside_it() -> None:
    assert scene(2, lanes=ramp_ahead(100.0)).home_lane == 1


def test_on_a_ramp_the_lead_is_the_car_ahead_on_the_ramp() -> None:
    lead = scene(2, (1, 20.0, 15.0), (2, 40.0, 12.0), lanes=ramp_ahead(200.0)).lead
    assert lead is not None
    assert lead.id == 2
