"""What stands of the wishes, one after the other: until when, what replaces it, and what a stop leaves of it."""

from __future__ import annotations

from typing import Any

import pytest

from schemas.driving.intent import ANY_LANE, ASSERTIVE, CALM, NORMAL
from schemas.wire.messages import Directive, EventKind, MetaAction, Reason
from tests.follower import DEFAULT_HEADWAY_S, HIGHWAY, LEAD, PASSED, Follower, observation, shut
from tests.scenes import car, directive, lane

EXPIRED, FULFILLED = EventKind.EXPIRED, EventKind.FULFILLED
ROAD: dict[str, Any] = {"lanes": HIGHWAY, "lane": 1}
"""One way; the limit is 26 m/s."""
LEFT_NOW: dict[str, Any] = {"lanes": HIGHWAY, "lane": 0}


@pytest.fixture
def follower() -> Follower:
    return Follower()


def wish(number: int, **fields: Any) -> Directive:
    """In answer to a command of its own."""
    return directive(id=number, command_id=number, **fields)


# The lane.


def test_without_words_any_lane_will_do_where_there_is_a_choice(follower):
    assert follower.at(observation(0, **ROAD)).lane == ANY_LANE


def test_without_words_the_only_lane_of_our_way_is_kept(follower):
    assert follower.at(observation(0)).lane == 1
    alone = (lane(0), lane(1, end_m=600.0))
    assert Follower().at(observation(0, lanes=alone, lane=0)).lane == 0


def test_without_words_a_lane_that_ends_is_left_to_the_side_where_one_goes_on(follower):
    only_right = (lane(0, end_m=600.0), lane(1))
    assert follower.at(observation(0, lanes=only_right, lane=0)).lane == ANY_LANE


def test_a_lane_that_was_reached_is_kept_beyond_the_time_to_live(follower):
    follower.at(observation(0, **LEFT_NOW), wish(1, target_lane=0, ttl_s=1.0))
    assert follower.at(observation(2000, **LEFT_NOW)).lane == 0


def test_a_lane_that_was_not_reached_in_time_is_given_up(follower):
    follower.at(observation(0, **ROAD), wish(1, target_lane=0, ttl_s=1.0))
    assert follower.at(observation(20, **ROAD)).kinds == [EXPIRED]
    assert follower.at(observation(21, **ROAD)).lane == ANY_LANE


def test_a_lane_that_is_changed_to_as_the_time_runs_out_is_kept(follower):
    follower.at(observation(0, **ROAD), wish(1, target_lane=0, ttl_s=1.0))
    assert follower.at(observation(20, lanes=HIGHWAY, lane=0, previous_lane=1)).lane == 0


@pytest.mark.parametrize(
    ("fields", "kept"),
    [
        ({"target_lane": 1}, 1),
        ({"headway_s": 2.0}, 0),
        ({"target_speed_mps": 4.0}, ANY_LANE),
        ({"manoeuvre": "overtake"}, ANY_LANE),
        ({"manoeuvre": "stop"}, 0),
        ({}, ANY_LANE),
    ],
    ids=str,
)
def test_a_lane_is_kept_until_another_lane_a_speed_or_an_overtake_is_wished(follower, fields, kept):
    follower.at(observation(0, **LEFT_NOW), wish(1, target_lane=0))
    assert follower.at(observation(1, **LEFT_NOW), wish(2, **fields)).lane == kept


def test_a_lane_wished_before_a_stop_is_not_gone_back_to_after_it(follower):
    follower.at(observation(0, **LEFT_NOW), wish(1, target_lane=0))
    follower.at(observation(1, **LEFT_NOW), wish(2, manoeuvre="stop"))
    assert follower.at(observation(2, **LEFT_NOW), wish(3, headway_s=2.0)).lane == ANY_LANE


@pytest.mark.parametrize(("end_m", "kept"), [(600.0, 1), (599.9, 0)])
def test_a_lane_is_wished_no_more_once_it_ends_within_ten_seconds_and_fifty_metres(follower, end_m, kept):
    road: dict[str, Any] = {"lanes": (lane(0), lane(1, end_m=end_m)), "lane": 1}
    follower.at(observation(0, lanes=(lane(0), lane(1)), lane=1), wish(1, target_lane=1))
    assert follower.at(observation(1, **road)).lane == kept


def test_a_lane_that_ends_before_it_was_reached_is_not_taken_for_fulfilled(follower):
    road: dict[str, Any] = {"lanes": (lane(0), lane(1), lane(2, end_m=510.0)), "lane": 1}
    assert follower.at(observation(0, **road), wish(1, target_lane=2)) == (ANY_LANE, 5, DEFAULT_HEADWAY_S, [])


def test_a_ramp_is_no_lane_to_wish_for(follower):
    road: dict[str, Any] = {"lanes": (lane(0), lane(1), lane(2, ramp=True)), "lane": 1}
    assert follower.at(observation(0, **road), wish(1, target_lane=2)).lane == ANY_LANE


# Speed and gap.


def test_a_directive_replaces_only_what_it_names(follower):
    follower.at(observation(0, **ROAD), wish(1, target_speed_mps=20.0, headway_s=3.0))
    assert follower.at(observation(1, **ROAD), wish(2, target_lane=1))[:3] == (1, 20.0, 3.0)
    assert follower.at(observation(2, **ROAD), wish(3, headway_s=1.2))[:3] == (1, 20.0, 1.2)
    assert follower.at(observation(3, **ROAD), wish(4, target_speed_mps=10.0))[:3] == (ANY_LANE, 10.0, 1.2)


def test_a_gap_of_nothing_is_none(follower):
    follower.at(observation(0, **ROAD), wish(1, headway_s=3.0))
    assert follower.at(observation(1, **ROAD), wish(2, headway_s=0.0, target_lane=1)).headway == 3.0


def test_a_gap_and_a_speed_outlive_their_directive(follower):
    follower.at(observation(0, **ROAD), wish(1, target_speed_mps=20.0, headway_s=3.0, ttl_s=1.0))
    assert follower.at(observation(5000, **ROAD))[:3] == (ANY_LANE, 20.0, 3.0)


def test_normal_again_is_as_without_words(follower):
    before = follower.at(observation(0, **ROAD))
    follower.at(observation(1, **ROAD), wish(1, target_speed_mps=20.0, headway_s=3.0, style="calm"))
    follower.at(observation(2, **LEFT_NOW), wish(2, target_lane=0))
    assert follower.at(observation(3, **LEFT_NOW), wish(3))[:3] == before[:3]
    assert follower.style == NORMAL


def test_in_a_new_world_nothing_stands(follower):
    follower.at(observation(0, **LEFT_NOW), wish(1, target_lane=0, headway_s=3.0, style="calm"))
    follower.at(observation(1, **LEFT_NOW), wish(2, target_speed_mps=20.0))
    assert follower.at(observation(0, epoch=2, **ROAD)) == (ANY_LANE, 5, DEFAULT_HEADWAY_S, [])
    assert follower.style == NORMAL


def test_a_speed_above_the_limit_here_is_driven_where_the_limit_is_higher(follower):
    follower.at(observation(0, lanes=HIGHWAY, lane=0), wish(1, target_speed_mps=27.0))
    assert follower.at(observation(1, lanes=HIGHWAY, lane=3)).speed == 27.0


@pytest.mark.parametrize("at_s", [0, 2, 10])
@pytest.mark.parametrize("set_point", [3.0, 5.0, 26.0])
@pytest.mark.parametrize(
    "fields",
    [
        {"target_speed_mps": 26.0},
        {"target_speed_mps": 5.0},
        {"target_lane": 0},
        {"manoeuvre": "overtake", "target_speed_mps": 26.0},
        {"headway_s": 1.2},
    ],
    ids=str,
)
def test_the_same_wish_comes_down_to_the_same_whenever_it_is_spoken(fields, set_point, at_s):
    def told(follower: Follower, tick: int, **state: Any) -> tuple[int, float, float]:
        return follower.at(observation(tick, car(1, 600, 1, 4), **ROAD, **state), wish(1, stamp_ns=tick, **fields))[:3]

    late = Follower()
    for tick in range(15 * at_s):
        late.at(observation(tick, car(1, 600, 1, 4), **ROAD, target_speed_mps=5.0 if not tick else set_point))
    assert told(late, 15 * at_s, target_speed_mps=set_point if at_s else 5.0) == told(Follower(), 0)


def test_a_speed_that_is_no_number_is_none(follower):
    assert follower.at(observation(0), wish(1, target_speed_mps=float("nan"))).speed == 5
    assert follower.at(observation(1), wish(2, headway_s=float("inf"))).headway == DEFAULT_HEADWAY_S


# The style.


@pytest.mark.parametrize(
    ("second", "style", "headway"),
    [
        ({"target_lane": 1}, CALM, 2.0),
        ({"target_speed_mps": 7.0}, NORMAL, DEFAULT_HEADWAY_S),
        ({"headway_s": 1.2}, NORMAL, 1.2),
        ({"style": "assertive"}, ASSERTIVE, 1.2),
        ({"target_lane": 1, "style": "assertive"}, ASSERTIVE, 1.2),
        ({}, NORMAL, DEFAULT_HEADWAY_S),
    ],
    ids=str,
)
def test_a_style_stands_until_another_speed_gap_or_style_is_wished(follower, second, style, headway):
    follower.at(observation(0), wish(1, target_speed_mps=4.0, style="calm", ttl_s=1.0))
    assert (follower.at(observation(30)).headway, follower.style) == (2.0, CALM)
    assert (follower.at(observation(31), wish(2, **second)).headway, follower.style) == (headway, style)


def test_the_style_of_an_overtake_ends_with_it(follower):
    overtake = wish(1, manoeuvre="overtake", style="assertive")
    assert (follower.at(observation(0, LEAD), overtake).headway, follower.style) == (1.2, ASSERTIVE)
    follower.at(observation(1, PASSED))
    assert (follower.at(observation(2, PASSED)).headway, follower.style) == (DEFAULT_HEADWAY_S, NORMAL)


def test_the_style_of_a_stop_lasts_while_the_ego_stands(follower):
    follower.at(observation(0), wish(1, manoeuvre="stop", style="calm"))
    assert follower.style == CALM
    follower.at(observation(900, speed=0.0))
    assert follower.style == CALM
    follower.at(observation(901, speed=0.0), wish(2, target_lane=1))
    assert follower.style == NORMAL


# After a stop.


@pytest.mark.parametrize(
    ("fields", "speed"),
    [
        ({}, 5),
        ({"target_speed_mps": 7.0}, 7.0),
        ({"target_lane": 1}, 6.0),
        ({"manoeuvre": "overtake"}, 8.0),
        ({"manoeuvre": "follow", "headway_s": 1.2}, 6.0),
        ({"manoeuvre": "follow"}, 6.0),
    ],
    ids=str,
)
def test_after_a_stop_every_other_wish_moves_the_car_again(follower, fields, speed):
    follower.at(observation(0), wish(1, target_speed_mps=6.0))
    for tick in range(1, 60):
        assert follower.at(observation(tick, speed=0.0), wish(2, manoeuvre="stop", target_speed_mps=0.0)).speed == 0.0
    assert follower.at(observation(60, speed=0.0), wish(3, **fields)).speed == speed


def test_who_has_never_had_a_speed_goes_on_up_to_the_limit(follower):
    still: dict[str, Any] = {"speed": 0.0, "target_speed_mps": 0.0}
    assert follower.at(observation(0, **still)).speed == 0
    assert follower.at(observation(1, **still), wish(1, target_lane=1)).speed == 8.0


def test_a_speed_of_nothing_is_a_stop(follower):
    assert follower.at(observation(0, **LEFT_NOW), wish(1, target_speed_mps=0.4, target_lane=1))[:2] == (0, 0.0)
    assert follower.at(observation(1, **LEFT_NOW), wish(2, target_lane=1)).speed == 5


def test_a_stop_that_was_not_fulfilled_in_time_goes_on(follower):
    follower.at(observation(0), wish(1, manoeuvre="stop", ttl_s=1.0))
    assert follower.at(observation(20)) == (1, 0.0, DEFAULT_HEADWAY_S, [(EXPIRED, None, -1, 0, pytest.approx(4 / 3))])
    assert follower.at(observation(21)).speed == 0.0


def test_a_stop_that_a_car_behind_keeps_in_the_oncoming_lane_neither_hurries_nor_counts_as_fulfilled(follower):
    behind = shut(MetaAction.RIGHT, by=Reason.REAR_GAP, vehicle=3)
    stop = wish(1, manoeuvre="stop", target_lane=1, target_speed_mps=0.0)
    seen = [follower.at(observation(tick, lane=0, speed=8.0), stop, behind) for tick in range(30)]
    assert {(at.lane, at.speed) for at in seen} == {(1, 0.0)}
    assert [kind for at in seen for kind in at.kinds] == [EventKind.DELAYED]
    assert follower.at(observation(30, speed=8.0)).kinds == []


def test_a_speed_that_is_overridden_is_not_met_by_the_speed_that_overrides_it(follower):
    told = wish(1, target_lane=0, target_speed_mps=7.0)
    follower.at(observation(0, **ROAD), told, shut(MetaAction.LEFT, by=Reason.REAR_GAP, vehicle=3))
    assert follower.at(observation(1, **ROAD)).speed == 26.0
    follower.at(observation(2, lanes=HIGHWAY, lane=0, previous_lane=1, speed=25.0))
    assert follower.at(observation(3, lanes=HIGHWAY, lane=0, speed=25.0)) == (0, 7.0, DEFAULT_HEADWAY_S, [])
