"""What a directive comes down to at each tick, and what is reported of it: the mask's closures are given by hand."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from fast_node.coordination import CARRIED_OUT, Coordination
from schemas.driving.intent import ANY_LANE
from schemas.runtime.clock import NS
from schemas.wire.codec import rows_of
from schemas.wire.messages import Closure, Directive, Event, Lane, MetaAction, Observation, Reason

HZ = 15
DEFAULT_HEADWAY_S = 1.5
TWO_WAY = (
    Lane(y_m=0, start_m=0, end_m=3000, direction=-1, kind="oncoming", speed_limit_mps=9.0),
    Lane(y_m=4, start_m=0, end_m=3000, speed_limit_mps=8.0),
)
HIGHWAY = tuple(Lane(y_m=4.0 * k, start_m=0, end_m=9000, speed_limit_mps=25.0 + k) for k in range(4))
DELAYED, OVERRIDDEN, BEGUN, FULFILLED, EXPIRED = "delayed", "overridden", "carried_out", "fulfilled", "expired"
LEFT, RIGHT, CRUISE, SPEED_UP = MetaAction.LEFT, MetaAction.RIGHT, MetaAction.CRUISE, MetaAction.SPEED_UP


class Told(NamedTuple):
    """An event, in short."""

    kind: str
    rule: str
    vehicle: int
    since: int
    seconds: float


class Seen(NamedTuple):
    """The intent at a tick, and what is reported."""

    lane: int
    speed: float
    headway: float
    told: list[Told]

    @property
    def kinds(self) -> list[str]:
        return [told.kind for told in self.told]


def told(event: Event) -> Told:
    kind = BEGUN if event.detail == CARRIED_OUT else event.kind
    return Told(kind, event.rule or "", event.vehicle, event.since_tick, event.duration_s)


def car(number: int, x: float, lane: int, speed: float) -> tuple[float, ...]:
    return (number, x, 4.0 * lane, speed, 0, 0, 5, 2, lane)


def observation(
    tick: int, *cars: tuple[float, ...], lane: int = 1, speed: float = 5.0, x: float = 500.0, **fields: Any
) -> Observation:
    rows = np.array([car(0, x, fields.pop("ego_lane", lane), speed), *cars], np.float32)
    given = {"epoch": 1, "stamp_ns": 77, "scenario": "", "lanes": TWO_WAY, "target_speed_mps": 5.0, **fields}
    return Observation(tick=tick, rows=rows.tobytes(), target_lane=lane, hz=HZ, **given)


def directive(**fields: Any) -> Directive:
    return Directive(**{"epoch": 1, "stamp_ns": 0, "id": 5, "command_id": 4, "scene_tick": 0, **fields})


class Follower:
    """Coordination, tick by tick: what the node asks of it and tells it."""

    def __init__(self) -> None:
        self.coordination = Coordination(DEFAULT_HEADWAY_S)
        self.events: list[Event] = []

    def at(
        self,
        seen: Observation,
        follows: Directive | None = None,
        closed: dict[MetaAction, Closure] | None = None,
        does: MetaAction = CRUISE,
        now_s: float | None = None,
    ) -> Seen:
        """A tick: what is seen and told, what the mask closes, what the ego does. now_s: by default the tick's."""
        now_ns = round((seen.tick / HZ if now_s is None else now_s) * NS)
        wish, events = self.coordination.wish(seen, rows_of(seen).tolist(), follows, now_ns)
        events += self.coordination.verdict(seen, wish, tuple((closed or {}).values()), does)
        self.events += events
        return Seen(wish.lane, wish.speed_mps, wish.headway_s, [told(event) for event in events])


def shut(*actions: MetaAction, by: Reason, vehicle: int = -1) -> dict[MetaAction, Closure]:
    return {action: Closure(action=int(action), rule=by, vehicle=vehicle) for action in actions}


@pytest.fixture
def follower() -> Follower:
    return Follower()


# What is done when nothing is told.


def test_told_nothing_the_ego_keeps_its_lane_its_set_point_and_the_usual_headway(follower):
    assert follower.at(observation(0, target_speed_mps=6.6)) == (1, 7, DEFAULT_HEADWAY_S, [])


def test_without_a_set_point_the_speed_it_has_is_kept(follower):
    assert follower.at(observation(0, target_speed_mps=0.0, speed=3.4)).speed == 3


def test_the_speed_kept_is_that_of_the_first_tick_of_the_world(follower):
    follower.at(observation(0, target_speed_mps=6.0))
    assert follower.at(observation(1, target_speed_mps=7.0)).speed == 6
    assert follower.at(observation(0, target_speed_mps=7.0, epoch=2)).speed == 7


def test_a_new_world_ends_the_directive_of_the_old_one(follower):
    follower.at(observation(0), directive(target_speed_mps=7.0))
    assert follower.at(observation(0, epoch=2), directive(target_speed_mps=7.0)).speed == 5


def test_in_a_new_world_a_directive_may_have_a_smaller_number(follower):
    follower.at(observation(0), directive(target_speed_mps=7.0))
    assert follower.at(observation(0, epoch=2), directive(epoch=2, id=1, target_speed_mps=6.0)).speed == 6


# Which directive is followed, and how long.


def test_a_directive_stays_in_force_until_the_next_one(follower):
    follower.at(observation(0), directive(target_speed_mps=6.0))
    assert follower.at(observation(1)).speed == 6
    assert follower.at(observation(2), directive(id=6, target_speed_mps=7.0)).speed == 7


@pytest.mark.parametrize("number", [4, 5])
def test_a_directive_that_is_not_newer_is_ignored(follower, number):
    follower.at(observation(0), directive(target_speed_mps=6.0))
    assert follower.at(observation(1), directive(id=number, target_speed_mps=7.0)).speed == 6


def test_a_directive_is_in_force_to_the_end_of_its_time_to_live_and_no_longer(follower):
    short = directive(stamp_ns=NS, target_speed_mps=7.0, target_lane=0, ttl_s=2.0)
    two_lanes = {"lanes": HIGHWAY, "lane": 1}
    assert follower.at(observation(0, **two_lanes), short, now_s=3.0)[:2] == (0, 7.0)
    late = follower.at(observation(30, **two_lanes), now_s=3.0 + 1e-9)
    assert late == (1, 5, DEFAULT_HEADWAY_S, [(EXPIRED, "", -1, 0, 2.0)])


def test_the_end_of_a_directive_is_reported_once(follower):
    follower.at(observation(0), directive(target_speed_mps=7.0, ttl_s=1.0))
    assert [follower.at(observation(tick)).kinds for tick in (20, 21)] == [[EXPIRED], []]


def test_a_directive_that_is_fulfilled_does_not_expire(follower):
    assert follower.at(observation(0), directive(target_speed_mps=5.0, ttl_s=1.0)).kinds == [FULFILLED]
    assert follower.at(observation(20)).kinds == []


def test_once_fulfilled_a_speed_is_kept_beyond_the_time_to_live(follower):
    follower.at(observation(0, speed=7.0), directive(target_speed_mps=7.0, ttl_s=1.0))
    assert follower.at(observation(20)).speed == 7


def test_a_speed_that_was_never_reached_is_given_up_with_its_directive(follower):
    follower.at(observation(0), directive(target_speed_mps=7.0, ttl_s=1.0))
    assert follower.at(observation(20)).speed == 5


def test_a_fulfilled_cruise_goes_on_as_it_was_told(follower):
    follower.at(observation(0), directive(target_speed_mps=5.0, headway_s=3.0))
    assert follower.at(observation(1)) == (1, 5.0, 3.0, [])


def test_a_stop_that_is_fulfilled_is_followed_by_standing(follower):
    assert follower.at(observation(0, speed=0.2), directive(manoeuvre="stop", headway_s=3.0)).kinds == [FULFILLED]
    assert follower.at(observation(1, speed=0.0)) == (1, 0.0, DEFAULT_HEADWAY_S, [])


# Which speed.


@pytest.mark.parametrize(("asked", "speed"), [(7.5, 7.5), (30.0, 8.0), (-1.0, 0.0), (0.0, 0.0)])
def test_a_speed_is_that_of_the_directive_within_the_limit_of_the_lane(follower, asked, speed):
    assert follower.at(observation(0), directive(target_speed_mps=asked)).speed == speed


def test_in_a_borrowed_lane_the_limit_is_that_of_the_way_home(follower):
    assert follower.at(observation(0, lane=0), directive(target_speed_mps=30.0)).speed == 8.0


def test_a_cruise_without_a_speed_keeps_the_speed(follower):
    assert follower.at(observation(0, target_speed_mps=6.0), directive(target_lane=1)).speed == 6


def test_an_overtake_without_a_speed_goes_up_to_the_limit(follower):
    assert follower.at(observation(0), directive(manoeuvre="overtake")).speed == 8.0


def test_an_overtake_with_a_speed_keeps_to_it(follower):
    assert follower.at(observation(0), directive(manoeuvre="overtake", target_speed_mps=7.0)).speed == 7.0


def test_a_stop_is_standing_in_the_own_lane_whatever_else_it_says(follower):
    stop = directive(manoeuvre="stop", target_speed_mps=7.0, target_lane=3)
    assert follower.at(observation(0, lanes=HIGHWAY), stop)[:2] == (1, 0.0)


# Which headway.


@pytest.mark.parametrize(
    ("fields", "headway"),
    [
        ({}, DEFAULT_HEADWAY_S),
        ({"style": "normal"}, DEFAULT_HEADWAY_S),
        ({"style": "assertive"}, 1.0),
        ({"style": "calm"}, 2.0),
        ({"style": "calm", "headway_s": 0.8}, 0.8),
        ({"style": "calm", "headway_s": 0.0}, 2.0),
    ],
)
def test_the_headway_is_that_of_the_directive_or_of_its_style(follower, fields, headway):
    assert follower.at(observation(0), directive(**fields)).headway == headway


# Which lane.


@pytest.mark.parametrize(("asked", "lane"), [(0, 0), (2, 2), (3, 3), (4, 1), (-1, 1), (-2, 1)])
def test_the_lane_is_that_of_the_directive_where_there_is_one(follower, asked, lane):
    assert follower.at(observation(0, lanes=HIGHWAY), directive(target_lane=asked)).lane == lane


def test_nobody_cruises_in_the_oncoming_lane(follower):
    assert follower.at(observation(0), directive(target_lane=0)).lane == 1


def test_from_a_borrowed_lane_it_goes_home(follower):
    assert follower.at(observation(0, lane=0)).lane == 1


def test_from_a_lane_that_ends_it_goes_to_the_nearest_that_goes_on(follower):
    road = [Lane(y_m=4.0 * k, start_m=0, end_m=900 if k < 2 else 400) for k in range(4)]
    assert [follower.at(observation(0, lanes=tuple(road), lane=lane)).lane for lane in range(4)] == [0, 1, 1, 1]


@pytest.mark.parametrize(("asked", "lane"), [(5.1, ANY_LANE), (5.0, 1), (4.0, 1), (None, 1)])
def test_any_lane_will_do_for_who_is_told_to_go_faster(follower, asked, lane):
    assert follower.at(observation(0, lanes=HIGHWAY), directive(target_speed_mps=asked)).lane == lane


def test_who_is_told_to_go_faster_in_a_lane_goes_to_that_lane(follower):
    assert follower.at(observation(0, lanes=HIGHWAY), directive(target_speed_mps=20.0, target_lane=2)).lane == 2


def test_any_lane_will_do_to_overtake_where_none_is_oncoming(follower):
    assert (
        follower.at(observation(0, car(1, 520, 1, 3), lanes=HIGHWAY), directive(manoeuvre="overtake")).lane == ANY_LANE
    )


def test_a_lane_that_is_told_to_overtake_in_is_taken_where_none_is_oncoming(follower):
    told_lane = directive(manoeuvre="overtake", target_lane=2)
    assert follower.at(observation(0, car(1, 520, 1, 3), lanes=HIGHWAY), told_lane).lane == 2


OVERTAKE = directive(manoeuvre="overtake", target_speed_mps=8.0)
LEAD, PASSED = car(1, 514, 1, 4), car(1, 490, 1, 4)


def test_the_oncoming_lane_is_taken_beside_the_car_to_pass_and_left_once_that_is_passed(follower):
    assert follower.at(observation(0, LEAD), OVERTAKE).lane == 0
    assert follower.at(observation(1, PASSED, lane=0)).lane == 1


def test_the_car_to_pass_is_the_one_that_was_ahead_when_the_directive_came(follower):
    follower.at(observation(0, LEAD, car(2, 530, 1, 4)), OVERTAKE)
    assert follower.at(observation(1, PASSED, car(2, 530, 1, 4), lane=0)).lane == 1


def test_the_car_to_pass_is_looked_for_in_the_own_lane_from_the_borrowed_one(follower):
    assert follower.at(observation(0, LEAD, car(2, 505, 0, -4), lane=0), OVERTAKE).lane == 0


@pytest.mark.parametrize(("asked", "lane"), [(1, 1), (0, 0)])
def test_who_is_told_to_overtake_in_the_own_lane_stays_in_it(follower, asked, lane):
    told_lane = directive(manoeuvre="overtake", target_lane=asked)
    assert follower.at(observation(0, LEAD), told_lane).lane == lane


def test_with_nobody_to_pass_the_own_lane_is_kept(follower):
    assert follower.at(observation(0), OVERTAKE).lane == 1


def test_beside_the_leftmost_lane_there_is_none_to_borrow(follower):
    mirrored = (HIGHWAY[0], Lane(y_m=4, start_m=0, end_m=9000, direction=-1, kind="oncoming"))
    assert follower.at(observation(0, car(1, 520, 0, 3), lanes=mirrored, lane=0), OVERTAKE).lane == ANY_LANE


# When a directive is fulfilled.


def test_a_fulfilled_directive_is_reported_with_its_length_and_what_it_is_an_answer_to(follower):
    follower.at(observation(3), directive(target_speed_mps=7.0))
    follower.at(observation(33, speed=7.0))
    (event,) = follower.events
    assert event == Event(
        epoch=1,
        stamp_ns=77,
        kind=event.kind,
        node="fast",
        tick=33,
        rule=event.rule,
        since_tick=3,
        duration_s=2.0,
        directive_id=5,
        command_id=4,
    )
    assert told(event) == (FULFILLED, "", -1, 3, 2.0)


@pytest.mark.parametrize(("speed", "met"), [(6.5, True), (6.25, False), (7.5, True), (7.75, False)])
def test_a_speed_is_met_within_half_a_metre_per_second(follower, speed, met):
    assert follower.at(observation(0, speed=speed), directive(target_speed_mps=7.0)).kinds == [FULFILLED] * met


def test_a_speed_above_the_limit_is_met_at_the_limit(follower):
    assert follower.at(observation(0, speed=8.0), directive(target_speed_mps=30.0)).kinds == [FULFILLED]


def test_a_stop_is_met_only_at_a_standstill(follower):
    assert follower.at(observation(0, speed=5.0), directive(manoeuvre="stop")).kinds == []


def test_a_lane_alone_is_met_at_any_speed(follower):
    seen = observation(0, lanes=HIGHWAY, speed=1.0)
    assert follower.at(seen, directive(target_lane=1)).kinds == [FULFILLED]


def test_a_lane_is_met_once_it_is_aimed_for_and_the_change_is_over(follower):
    there = directive(target_lane=2)
    assert follower.at(observation(0, lanes=HIGHWAY, lane=1), there).kinds == []
    assert follower.at(observation(1, lanes=HIGHWAY, lane=2, previous_lane=1)).kinds == []
    assert follower.at(observation(2, lanes=HIGHWAY, lane=2, previous_lane=0)).kinds == []
    assert follower.at(observation(3, lanes=HIGHWAY, lane=2)).kinds == [FULFILLED]


def test_a_speed_in_any_lane_is_met_in_any(follower):
    seen = observation(0, lanes=HIGHWAY, speed=20.0)
    assert follower.at(seen, directive(target_speed_mps=20.0)) == (ANY_LANE, 20.0, 1.5, [(FULFILLED, "", -1, 0, 0.0)])


@pytest.mark.parametrize(("x", "met"), [(516.0, True), (515.9, True), (515.5, True), (513.9, False)])
def test_a_headway_is_met_with_nine_tenths_of_it(follower, x, met):
    # 2 s at 5 m/s are 10 m, nine tenths of it 9 m; the cars are 5 m long.
    seen = observation(0, car(2, 505.5, 0, -5), car(1, x, 1, 5))
    assert follower.at(seen, directive(headway_s=2.0)).kinds == [FULFILLED] * met


def test_a_headway_of_exactly_nine_tenths_is_met(follower):
    assert follower.at(observation(0, car(1, 514.0, 1, 5)), directive(headway_s=2.0)).kinds == [FULFILLED]


def test_the_headway_is_kept_to_the_next_car_and_to_no_other(follower):
    seen = observation(0, car(2, 560, 1, 5), car(1, 540, 1, 5), car(3, 503, 0, 5), lanes=HIGHWAY)
    assert follower.at(seen, directive(headway_s=2.0)).kinds == [FULFILLED]


def test_a_style_asks_for_no_headway_before_it_is_fulfilled(follower):
    assert follower.at(observation(0, car(1, 506, 1, 5)), directive(style="calm")).kinds == [FULFILLED]


def test_an_overtake_is_fulfilled_when_the_car_is_passed_the_ego_is_home_and_the_change_over(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    assert follower.at(observation(1, LEAD)).kinds == []
    assert follower.at(observation(2, PASSED, lane=0)).kinds == []
    assert follower.at(observation(3, PASSED, previous_lane=0)).kinds == []
    assert follower.at(observation(4, PASSED)).kinds == [FULFILLED]


def test_an_overtake_is_not_fulfilled_while_there_is_no_room_to_move_in_before_the_car(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    assert follower.at(observation(1, car(1, 491.5, 1, 4))).kinds == []


def test_an_overtake_is_not_fulfilled_by_losing_the_car_ahead_out_of_reach(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    assert follower.at(observation(1, car(1, 580, 1, 8))).kinds == []


def test_an_overtake_is_fulfilled_whatever_the_speed_and_whoever_is_ahead_then(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    assert follower.at(observation(1, PASSED, car(2, 510, 1, 4), speed=3.0)).kinds == [FULFILLED]


def test_with_nobody_to_pass_on_a_two_way_road_an_overtake_is_not_fulfilled(follower):
    assert follower.at(observation(0, speed=8.0), OVERTAKE).kinds == []


def test_with_nobody_to_pass_where_no_lane_is_oncoming_the_speed_will_do(follower):
    assert follower.at(observation(0, lanes=HIGHWAY, speed=8.0), OVERTAKE).kinds == [FULFILLED]
    left = Follower()
    assert left.at(observation(0, lanes=HIGHWAY, speed=8.0, lane=0), OVERTAKE).kinds == [FULFILLED]


# What the mask holds back: lane changes.

REAR = shut(LEFT, by=Reason.REAR_GAP, vehicle=8)
FRONT = shut(LEFT, by=Reason.FRONT_GAP, vehicle=9)
TO_THE_LEFT, TO_THE_RIGHT = directive(target_lane=0), directive(target_lane=3)
ROAD = {"lanes": HIGHWAY, "lane": 1}


def test_a_change_that_the_mask_holds_back_is_reported_once_with_its_rule_and_vehicle(follower):
    assert follower.at(observation(3, **ROAD), TO_THE_LEFT, FRONT).told == [(DELAYED, "front gap in lane", 9, 3, 0.0)]
    assert follower.at(observation(4, **ROAD), None, FRONT).told == []


def test_a_change_to_the_right_is_held_back_by_what_closes_the_right(follower):
    right = shut(RIGHT, by=Reason.FRONT_GAP, vehicle=7)
    assert follower.at(observation(0, **ROAD), TO_THE_RIGHT, {**FRONT, **right}).told == [
        (DELAYED, "front gap in lane", 7, 0, 0.0)
    ]


@pytest.mark.parametrize("told_lane", [TO_THE_RIGHT, directive(target_lane=1), directive(target_speed_mps=25.0)])
def test_what_closes_a_lane_that_is_not_asked_for_holds_nothing_back(follower, told_lane):
    assert DELAYED not in follower.at(observation(0, **ROAD), told_lane, FRONT).kinds


def test_another_rule_is_reported_with_the_beginning_of_the_delay(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    later = follower.at(observation(15, **ROAD), None, shut(LEFT, by=Reason.CHANGING))
    assert later.told == [(DELAYED, "one change at a time", -1, 0, 1.0)]
    assert follower.at(observation(16, **ROAD), None, FRONT).told == []


def test_a_change_that_begins_after_a_delay_is_reported_with_the_last_rule_and_the_length(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    follower.at(observation(15, **ROAD), None, shut(LEFT, by=Reason.CHANGING, vehicle=6))
    begun = follower.at(observation(30, **ROAD), None, None, LEFT)
    assert begun.told == [(BEGUN, "one change at a time", 6, 0, 2.0)]
    assert follower.at(observation(31, **ROAD), None, None, LEFT).told == []


def test_a_change_that_is_free_again_but_not_begun_is_not_reported(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    assert follower.at(observation(1, **ROAD)).told == []
    assert follower.at(observation(2, **ROAD), None, None, RIGHT).told == []
    assert follower.at(observation(30, **ROAD), None, None, LEFT).told == [(BEGUN, "front gap in lane", 9, 0, 2.0)]


def test_a_change_that_was_not_held_back_is_not_reported(follower):
    assert follower.at(observation(0, **ROAD), TO_THE_LEFT, None, LEFT).told == []


def test_a_delay_ends_where_its_change_is_no_longer_asked_for(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    follower.at(observation(1, lanes=HIGHWAY, lane=0, previous_lane=1))
    assert follower.at(observation(30, **ROAD), None, FRONT).told == [(DELAYED, "front gap in lane", 9, 30, 0.0)]


def test_what_ends_tells_the_last_rule_that_held_it_up(follower):
    follower.at(observation(0, **ROAD), directive(target_lane=0, ttl_s=1.0), FRONT)
    assert follower.at(observation(30, **ROAD)).told == [(EXPIRED, "front gap in lane", 9, 0, 2.0)]


def test_after_its_end_a_directive_delays_nothing(follower):
    follower.at(observation(0, **ROAD), directive(target_lane=0, ttl_s=1.0), FRONT)
    follower.at(observation(30, **ROAD), None, FRONT)
    assert follower.at(observation(31, **ROAD), None, FRONT).told == []


def test_told_nothing_nothing_is_delayed(follower):
    assert follower.at(observation(0, lane=0), None, shut(RIGHT, by=Reason.FRONT_GAP)).told == []


# A car behind: accelerate first, then change.


def test_held_back_by_a_car_behind_the_ego_accelerates_first_and_says_so_once(follower):
    first = follower.at(observation(0, **ROAD), TO_THE_LEFT, REAR)
    assert (first.speed, first.told) == (
        5,
        [(DELAYED, "rear gap in lane", 8, 0, 0.0), (OVERRIDDEN, "rear gap in lane", 8, 0, 0.0)],
    )
    assert follower.at(observation(1, **ROAD), None, REAR) == (0, 26.0, DEFAULT_HEADWAY_S, [])


def test_held_back_by_a_car_ahead_it_does_not_accelerate(follower):
    assert follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT).kinds == [DELAYED]
    assert follower.at(observation(1, **ROAD), None, FRONT).speed == 5


def test_where_the_limit_is_asked_for_already_nothing_is_overridden(follower):
    fast = directive(target_lane=0, target_speed_mps=40.0)
    assert follower.at(observation(0, **ROAD), fast, REAR).kinds == [DELAYED]


def test_just_below_the_limit_the_speed_is_overridden(follower):
    fast = directive(target_lane=0, target_speed_mps=25.5)
    assert follower.at(observation(0, **ROAD), fast, REAR).kinds == [DELAYED, OVERRIDDEN]


def test_a_later_car_behind_is_told_with_the_beginning_of_the_delay(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    assert follower.at(observation(15, **ROAD), None, REAR).told == [
        (DELAYED, "rear gap in lane", 8, 0, 1.0),
        (OVERRIDDEN, "rear gap in lane", 8, 0, 1.0),
    ]


def test_the_ego_keeps_accelerating_until_the_change_that_it_accelerated_for_is_over(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, REAR)
    follower.at(observation(1, **ROAD), None, None, LEFT)
    assert follower.at(observation(2, lanes=HIGHWAY, lane=0, previous_lane=1)).speed == 25.0
    assert follower.at(observation(3, lanes=HIGHWAY, lane=0)).speed == 5


def test_the_ego_keeps_accelerating_while_it_leaves_the_leftmost_lane(follower):
    home = directive(target_lane=1)
    follower.at(observation(0, lanes=HIGHWAY, lane=0), home, shut(RIGHT, by=Reason.REAR_GAP))
    follower.at(observation(1, lanes=HIGHWAY, lane=0), None, None, RIGHT)
    assert follower.at(observation(2, lanes=HIGHWAY, lane=1, previous_lane=0)).speed == 26.0


def test_another_rule_ends_the_acceleration(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, REAR)
    follower.at(observation(1, **ROAD), None, FRONT)
    assert follower.at(observation(2, **ROAD), None, FRONT).speed == 5


# What the mask holds back: speeds.

FASTER = directive(target_speed_mps=8.0, target_lane=1)
GAP = shut(SPEED_UP, by=Reason.SPEED_FOR_GAP, vehicle=3)


def test_a_speed_out_of_reach_for_a_second_is_reported_once(follower):
    told_at = {t: follower.at(observation(t), FASTER if t == 2 else None, GAP).told for t in range(2, 60)}
    assert {t: events for t, events in told_at.items() if events} == {
        17: [(DELAYED, "speed above the gap's", 3, 2, 1.0)]
    }


def test_a_speed_that_is_open_for_a_moment_is_out_of_reach_from_then_on(follower):
    for t in range(30):
        assert follower.at(observation(t), FASTER if t == 0 else None, GAP if t != 14 else None).told == []


def test_only_what_closes_a_faster_speed_delays_one(follower):
    for t in range(30):
        assert follower.at(observation(t), FASTER if t == 0 else None, shut(CRUISE, LEFT, by=Reason.LEAD)).told == []


@pytest.mark.parametrize(("speed", "reported"), [(7.0, []), (6.9, [DELAYED])])
def test_a_speed_is_out_of_reach_only_where_it_is_more_than_a_metre_per_second_off(follower, speed, reported):
    kinds = [
        k for t in range(30) for k in follower.at(observation(t, speed=speed), FASTER if not t else None, GAP).kinds
    ]
    assert kinds == reported


def test_the_delay_of_a_speed_is_told_again_once_the_speed_was_reached(follower):
    def wait(ticks: range) -> list[Told]:
        return [e for t in ticks for e in follower.at(observation(t), FASTER if not t else None, GAP).told]

    assert wait(range(20)) == [(DELAYED, "speed above the gap's", 3, 0, 1.0)]
    follower.at(observation(20, speed=7.2), None, GAP)
    assert wait(range(21, 60)) == [(DELAYED, "speed above the gap's", 3, 21, 1.0)]


def test_the_rule_told_of_a_speed_is_the_one_that_holds_it_back_then(follower):
    for t in range(15):
        follower.at(observation(t), FASTER if t == 0 else None, GAP)
    lead = shut(SPEED_UP, by=Reason.LEAD, vehicle=4)
    assert follower.at(observation(15), None, lead).told == [(DELAYED, "lead too close", 4, 0, 1.0)]


def test_a_speed_that_was_reported_is_not_reported_by_another_rule(follower):
    for t in range(20):
        follower.at(observation(t), FASTER if t == 0 else None, GAP)
    assert follower.at(observation(20), None, shut(SPEED_UP, by=Reason.LEAD)).told == []


def test_elsewhere_than_in_the_lane_asked_for_the_speed_is_not_told_of(follower):
    there = directive(target_speed_mps=20.0, target_lane=0)
    for t in range(30):
        assert follower.at(observation(t, **ROAD), there if t == 0 else None, GAP).told == []


def test_a_speed_waits_anew_after_a_lane_was_waited_for(follower):
    there = directive(target_speed_mps=20.0, target_lane=0)
    follower.at(observation(0, lanes=HIGHWAY, lane=0), there, GAP)
    assert follower.at(observation(1, **ROAD), None, {**GAP, **FRONT}).kinds == [DELAYED]
    told_at = [t for t in range(2, 40) if follower.at(observation(t, lanes=HIGHWAY, lane=0), None, GAP).told]
    assert told_at == [17]


def test_a_speed_that_was_told_of_is_not_told_of_again_after_a_lane_was_waited_for(follower):
    there = directive(target_speed_mps=20.0, target_lane=0)
    told_at = [
        t for t in range(20) if follower.at(observation(t, lanes=HIGHWAY, lane=0), there if not t else None, GAP).told
    ]
    follower.at(observation(20, **ROAD), None, {**GAP, **FRONT})
    told_at += [t for t in range(21, 50) if follower.at(observation(t, lanes=HIGHWAY, lane=0), None, GAP).told]
    assert told_at == [15]


# A directive that is renewed, and one that replaces it.


def test_a_renewed_directive_counts_from_the_first(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    follower.at(observation(15, **ROAD), directive(id=6, target_lane=0), None)
    assert follower.at(observation(30, lanes=HIGHWAY, lane=0)).told == [(FULFILLED, "front gap in lane", 9, 0, 2.0)]


def test_a_directive_of_another_command_counts_from_its_own_beginning(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    follower.at(observation(15, **ROAD), directive(id=6, command_id=9, target_lane=0), None)
    assert follower.at(observation(30, lanes=HIGHWAY, lane=0)).told == [(FULFILLED, "", -1, 15, 1.0)]


def test_the_same_command_after_its_end_counts_from_its_new_beginning(follower):
    follower.at(observation(0, lanes=HIGHWAY, lane=1), TO_THE_LEFT, FRONT)
    follower.at(observation(1, lanes=HIGHWAY, lane=0))
    follower.at(observation(15, **ROAD), directive(id=6, target_lane=0), None)
    assert follower.at(observation(30, lanes=HIGHWAY, lane=0)).told == [(FULFILLED, "", -1, 15, 1.0)]


def test_a_renewed_lane_is_delayed_anew(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, FRONT)
    assert follower.at(observation(15, **ROAD), directive(id=6, target_lane=0), FRONT).told == [
        (DELAYED, "front gap in lane", 9, 15, 0.0)
    ]


def test_a_renewed_speed_is_delayed_anew(follower):
    for t in range(15):
        follower.at(observation(t), FASTER if t == 0 else None, GAP)
    again = directive(id=6, target_speed_mps=8.0, target_lane=1)
    told_at = [t for t in range(15, 60) if follower.at(observation(t), again if t == 15 else None, GAP).told]
    assert told_at == [30]


def test_a_renewed_overtake_keeps_the_car_to_pass_and_what_was_told(follower):
    oncoming = shut(LEFT, by=Reason.ONCOMING, vehicle=2)
    assert follower.at(observation(0, LEAD), OVERTAKE, oncoming).kinds == [DELAYED]
    again = directive(id=6, manoeuvre="overtake", target_speed_mps=8.0)
    assert follower.at(observation(1, car(2, 508, 1, 4), LEAD), again, oncoming).kinds == []
    assert follower.at(observation(2, car(2, 508, 1, 4), PASSED, lane=0)).lane == 1


def test_an_overtake_of_another_command_looks_for_a_car_to_pass_anew(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    again = directive(id=6, command_id=9, manoeuvre="overtake", target_speed_mps=8.0)
    follower.at(observation(1, PASSED, car(2, 520, 1, 4)), again)
    assert follower.at(observation(2, PASSED, car(2, 520, 1, 4))).lane == 0


def test_a_cruise_after_an_overtake_has_nobody_to_pass(follower):
    follower.at(observation(0, LEAD), OVERTAKE)
    cruise = directive(id=6, command_id=9, target_lane=1)
    assert follower.at(observation(1, LEAD), cruise).told == [(FULFILLED, "", -1, 1, 0.0)]


def test_who_was_told_to_go_faster_and_then_not_keeps_the_lane(follower):
    follower.at(observation(0, lanes=HIGHWAY), directive(target_speed_mps=20.0))
    assert follower.at(observation(1, lanes=HIGHWAY), directive(id=6, headway_s=2.0)).lane == 1


def test_another_directive_ends_the_acceleration_for_a_car_behind(follower):
    follower.at(observation(0, **ROAD), TO_THE_LEFT, REAR)
    follower.at(observation(1, **ROAD), None, None, LEFT)
    under_way = observation(2, lanes=HIGHWAY, lane=0, previous_lane=1)
    assert follower.at(under_way, directive(id=6, command_id=9, target_lane=0)).speed == 5
