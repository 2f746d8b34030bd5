"""The safety mask and the coordination, on scenes made by hand and by hypothesis."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, get_args

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fast_node.choice import choose, narrow
from fast_node.config import FastConfig
from fast_node.mask import (
    CREEP_MPS,
    FOLLOWER_BLIND_S,
    NOT_WISHED,
    OPEN,
    OUT_M,
    PRESETS,
    RULES,
    VERSION,
    Preset,
    close_actions,
    half_width,
    lane_table,
    pass_time_s,
    passing,
    survey,
)
from fast_node.node import FastNode
from fast_node.policies.attention import load_policy
from schemas.driving import measures
from schemas.driving.intent import wished_lane
from schemas.wire.codec import rows_of
from schemas.wire.messages import Directive, Lane, Manoeuvre, MetaAction, Observation, Style
from sim_node import executor
from tests import mask_behaviour

LANES = [(0.0, 0.0, 3000.0, -1.0, 4.0, 8.0, -1e9, 0.0), (4.0, 0.0, 3000.0, 1.0, 4.0, 8.0, -1e9, 0.0)]
SIGHT_M = 250.0
SIM = PRESETS["sim"]


def car(number: int, x: float, lane: int, speed: float, y: float | None = None) -> list[float]:
    return [float(number), x, 4.0 * lane if y is None else y, speed, 0.0, 0.0, 5.0, 2.0, float(lane)]


def judge(
    rows, lanes, target_speed: float, lane: int, previous: int = -1, preset: Preset = SIM
) -> tuple[list[int], list[int]]:
    rule, vehicle = [0] * 6, [0] * 6
    near = [0] * (3 * len(lanes))
    opened = close_actions(rows, lanes, target_speed, lane, previous, SIGHT_M, near, rule, vehicle, preset)
    assert opened == sum(r == OPEN for r in rule)
    return rule, vehicle


def closed(rows: list[list[float]], *, target_speed: float = 5.0, lane: int = 1, previous: int = -1) -> dict[int, str]:
    rule, _ = judge(rows, LANES, target_speed, lane, previous)
    return {a: RULES[r] for a, r in enumerate(rule) if r != OPEN}


def test_a_free_road_leaves_every_speed_open_and_nothing_to_pass():
    assert closed([car(0, 500, 1, 5)]) == {MetaAction.LEFT: "nothing to pass", MetaAction.RIGHT: "no lane there"}


def test_a_slow_lead_may_be_passed_when_the_oncoming_lane_is_free():
    assert MetaAction.LEFT not in closed([car(0, 500, 1, 4), car(1, 512, 1, 3.5)])


def test_oncoming_traffic_closes_the_way_past_a_slow_lead_and_is_named():
    rows = [car(0, 500, 1, 4), car(1, 512, 1, 3.5), car(7, 600, 0, -6)]
    rule, vehicle = judge(rows, LANES, 4.0, 1)
    assert (RULES[rule[MetaAction.LEFT]], vehicle[MetaAction.LEFT]) == ("oncoming traffic", 7)


def test_leads_too_close_to_return_between_are_passed_together_if_there_is_time_for_both():
    two = [car(0, 500, 1, 4), car(1, 512, 1, 3.5), car(2, 522, 1, 3.5)]
    assert MetaAction.LEFT not in closed(two)
    assert MetaAction.LEFT not in closed([*two[:2], car(7, 660, 0, -6)])
    assert closed([*two, car(7, 660, 0, -6)])[MetaAction.LEFT] == "oncoming traffic"


def test_a_queue_as_far_as_one_can_see_leaves_no_gap_to_return_to():
    queue = [car(i, 500 + 12 * i, 1, 3.5) for i in range(1, 21)]
    assert closed([car(0, 500, 1, 4), *queue])[MetaAction.LEFT] == "no gap to return to"


def test_a_car_beside_or_close_behind_closes_the_return():
    assert closed([car(0, 500, 0, 7), car(1, 497, 1, 4)], lane=0)[MetaAction.RIGHT] == "rear gap in lane"


def test_a_pass_that_oncoming_traffic_makes_impossible_is_given_up():
    rows = [car(0, 500, 0, 5), car(1, 508, 1, 4), car(7, 560, 0, -6)]
    assert closed(rows, lane=0)[MetaAction.SPEED_UP] == "give up the pass"


def test_too_close_a_lead_leaves_only_the_emergency_brake():
    assert set(range(5)) <= set(closed([car(0, 500, 1, 8), car(1, 507, 1, 1)]))


def test_the_set_point_may_not_exceed_what_the_gap_admits():
    rows = [car(0, 500, 1, 4), car(1, 511, 1, 4)]
    assert closed(rows, target_speed=8.0)[MetaAction.CRUISE] == "speed above the gap's"


def test_the_time_of_a_pass_agrees_with_the_distance_gained():
    # 3 m/s faster is reached after 3 / 0.7 s and 6.43 m; the other 13.57 m take 13.57 / 3 s.
    assert abs(pass_time_s(20.0, 0.0, 3.0) - (3 / 0.7 + (20 - 4.5 / 0.7) / 3)) < 1e-9


def test_nothing_is_left_to_pass_once_there_is_room_to_return():
    rows, near = [car(0, 520, 0, 7), car(1, 510, 1, 4)], [0] * 6
    survey(rows, LANES, near)
    assert RULES[passing(rows, LANES, near, 1, 0, SIGHT_M, SIM)[0]] == "nothing to pass"


def test_the_wished_lane_is_the_oncoming_one_until_the_lead_is_passed():
    lead = car(3, 510, 1, 4)
    assert [wished_lane([car(0, x, 1, 6), lead], 1, 3) for x in (400, 495, 512, 520)] == [1, 0, 0, 1]


HIGHWAY = [(4.0 * k, 0.0, 9000.0, 1.0, 4.0, 28.0, -1e9, 0.0) for k in range(4)]
RAMP = [
    (0.0, 0.0, 750.0, 1.0, 4.0, 20.0, -1e9, 0.0),
    (4.0, 0.0, 750.0, 1.0, 4.0, 20.0, -1e9, 0.0),
    (8.0, 0.0, 350.0, 1.0, 4.0, 20.0, 230.0, 1.0),
]


def closed_on(lanes, rows, lane: int, previous: int = -1, target_speed: float | None = None) -> dict[int, str]:
    rule, _ = judge(rows, lanes, rows[0][3] if target_speed is None else target_speed, lane, previous)
    return {a: RULES[r] for a, r in enumerate(rule) if r != OPEN}


def test_a_faster_car_behind_in_the_next_lane_closes_the_change():
    rows = [car(0, 500, 2, 22), car(4, 470, 1, 27)]
    assert closed_on(HIGHWAY, rows, 2) == {MetaAction.LEFT: "rear gap in lane"}


def test_a_car_that_moves_into_the_next_lane_from_beyond_closes_the_change():
    rows = [car(0, 500, 2, 22), [*car(4, 498, 0, 22)[:4], 1.5, *car(4, 498, 0, 22)[5:]]]
    rows[1][2] = 1.0
    assert closed_on(HIGHWAY, rows, 2)[MetaAction.LEFT] == "rear gap in lane"


def test_a_car_that_cuts_in_ahead_limits_the_speed_before_it_is_in_the_lane():
    rows = [car(0, 500, 2, 25), car(4, 536, 1, 20)]
    rows[1][4], rows[1][2] = 1.5, 5.5
    assert closed_on(HIGHWAY, rows, 2)[MetaAction.CRUISE] == "speed above the gap's"


def test_a_car_that_crosses_the_lane_between_limits_the_speed_however_fast_it_crosses():
    crossing = car(1, 545, 1, 15, y=5.2)
    crossing[4] = 4.5
    behind_it = [car(0, 500, 3, 25, y=10.7), crossing]
    assert RULES[judge(behind_it, HIGHWAY, 25.0, 2, 3)[0][MetaAction.CRUISE]] == "speed above the gap's"


def test_a_change_home_that_oncoming_traffic_keeps_from_being_given_up_is_finished_without_delay():
    waits = [car(0, 520, 0, 0.5, y=0.04), car(1, 545, 1, 4.5), car(2, 503, 1, 5.4), car(7, 580, 0, -5)]
    crawling, moving = (closed(waits, target_speed=v, lane=1, previous=0) for v in (0.0, 5.0))
    assert [crawling.get(a) for a in range(4)] == ["rear gap in lane", "rear gap in lane", None, "oncoming traffic"]
    assert [moving.get(a) for a in range(4)] == ["rear gap in lane", None, None, "oncoming traffic"]


def test_a_change_that_a_fast_car_from_behind_makes_unsafe_is_given_up():
    rows = [car(0, 500, 2, 15, y=7.2), car(4, 480, 1, 28)]
    assert closed_on(HIGHWAY, rows, 1, previous=2)[MetaAction.CRUISE] == "give up the change"


def test_nobody_leaves_the_ramp_before_it_lies_beside_the_road():
    assert closed_on(RAMP, [car(0, 200, 2, 15)], 2)[MetaAction.LEFT] == "no lane there"
    assert MetaAction.LEFT not in closed_on(RAMP, [car(0, 240, 2, 15)], 2)


def test_nobody_drives_from_the_road_onto_the_ramp():
    assert closed_on(RAMP, [car(0, 260, 1, 15)], 1)[MetaAction.RIGHT] == "no lane there"


def test_the_end_of_the_ramp_slows_the_ego_down_and_then_stops_it():
    blocked = [car(i, 300 + 12 * i, 1, 14) for i in range(-4, 5) if i]
    assert closed_on(RAMP, [car(0, 300, 2, 18), *blocked], 2)[MetaAction.CRUISE] == "lane ends"
    assert set(range(5)) <= set(closed_on(RAMP, [car(0, 335, 2, 12), *blocked], 2))


ROADS = {"two-way": LANES, "highway": HIGHWAY, "merge": RAMP}
EGO_X_M = {"two-way": (500.0, 500.0), "highway": (500.0, 500.0), "merge": (200.0, 345.0)}


class Scene(NamedTuple):
    """All that the mask may read, but for the preset."""

    lanes: list[tuple[float, ...]]
    rows: list[list[float]]
    target_speed: float
    lane: int
    previous: int


def nearest_lane(lanes, y: float) -> int:
    return min(range(len(lanes)), key=lambda k: abs(lanes[k][0] - y))


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """Any road, a change under way or none, cars anywhere on it, moving sideways and standing askew."""
    name = draw(st.sampled_from(sorted(ROADS)))
    lanes = ROADS[name]
    top = 1.5 * lanes[-1][5]
    aim = draw(st.integers(0, len(lanes) - 1))
    previous = draw(st.sampled_from([-1, *(k for k in (aim - 1, aim + 1) if 0 <= k < len(lanes))]))
    start_y = lanes[aim if previous < 0 else previous][0]
    y = start_y + draw(st.floats(0.0, 1.0)) * (lanes[aim][0] - start_y)
    sideways, askew = st.floats(-2.5, 2.5), st.floats(-0.6, 0.6)
    changing = previous >= 0
    rows = [
        [
            0.0,
            draw(st.floats(*EGO_X_M[name])),
            y,
            draw(st.floats(0, top)),
            draw(sideways) if changing else 0.0,
            draw(askew) if changing else 0.0,
            5.0,
            2.0,
            float(nearest_lane(lanes, y)),
        ]
    ]
    others = draw(
        st.lists(
            st.tuples(
                st.floats(-100, 200),
                st.floats(-0.5, lanes[-1][0] + 0.5),
                st.floats(0, top),
                st.just(0.0) | sideways,
                st.just(0.0) | askew,
            ),
            max_size=10,
        )
    )
    for number, (dx, aside, speed, vy, heading) in enumerate(others, 11):
        k = nearest_lane(lanes, aside)
        rows.append(
            [float(number), rows[0][1] + dx, aside, math.copysign(speed, lanes[k][3]), vy, heading, 5.0, 2.0, float(k)]
        )
    rows = np.array(rows, np.float32).tolist()  # as they come over the bus
    return Scene(lanes, rows, draw(st.floats(0, top)), aim, previous)


presets = st.sampled_from(sorted(PRESETS))


@settings(max_examples=300, deadline=None)
@given(scenes(), presets)
def test_emergency_braking_is_always_open_and_every_closure_has_a_rule_and_a_vehicle_that_is_there(scene, preset):
    rule, vehicle = judge(scene.rows, scene.lanes, scene.target_speed, scene.lane, scene.previous, PRESETS[preset])
    seen = {int(row[0]) for row in scene.rows[1:]}
    assert rule[MetaAction.EMERGENCY_BRAKE] == OPEN
    assert all(RULES[r] for r in rule if r != OPEN)
    assert all(v == -1 or (r != OPEN and v in seen) for r, v in zip(rule, vehicle, strict=True))


wishes = st.tuples(st.sampled_from([-1, 0, 1]), st.floats(0, 8), st.floats(0.5, 4))


@settings(max_examples=300, deadline=None)
@given(scenes(), presets, wishes, st.lists(st.floats(-5, 5), min_size=5, max_size=5), st.booleans())
def test_a_wish_narrows_what_is_safe_and_never_down_to_braking(scene, preset, wish, logits, holding):
    rule, _ = judge(scene.rows, scene.lanes, scene.target_speed, scene.lane, scene.previous, PRESETS[preset])
    wished, near = rule.copy(), [0] * (3 * len(scene.lanes))
    survey(scene.rows, scene.lanes, near)
    narrow(wished, scene.rows, near, scene.lanes, scene.target_speed, scene.lane, scene.previous, *wish)
    meta, _ = choose(logits, wished, holding)
    assert rule[meta] == OPEN
    assert meta != MetaAction.EMERGENCY_BRAKE or all(r != OPEN for r in rule[:5])


directives = st.none() | st.builds(
    Directive,
    epoch=st.sampled_from([1, 1, 1, 9]),
    stamp_ns=st.just(0),
    id=st.integers(0, 9),
    command_id=st.integers(0, 3),
    scene_tick=st.just(0),
    manoeuvre=st.sampled_from(get_args(Manoeuvre)),
    target_lane=st.none() | st.integers(-1, 5),
    relative_lane=st.sampled_from([None, "left", "right"]),
    target_speed_mps=st.none() | st.floats(-5, 60),
    headway_s=st.none() | st.floats(0, 6),
    style=st.sampled_from(get_args(Style)),
    ttl_s=st.sampled_from([0.0, 1.0, 30.0]),
)
BROKEN = [(math.nan,) * 5, (math.inf, 0.0, 0.0, 0.0, 0.0), (0.0, 1.0), ()]
"""Logits of a policy that fails."""
KINDS = {"two-way": ("oncoming", "main"), "highway": ("main",) * 4, "merge": ("main", "main", "ramp")}


def seen_at(tick: int, scene: Scene) -> Observation:
    kinds = KINDS[next(n for n, table in ROADS.items() if table is scene.lanes)]
    lanes = tuple(
        Lane(
            y_m=b[0],
            start_m=b[1],
            end_m=b[2],
            direction=int(b[3]),
            width_m=b[4],
            speed_limit_mps=b[5],
            change_from_m=b[6],
            kind=kind,
        )
        for b, kind in zip(scene.lanes, kinds, strict=True)
    )
    return Observation(
        epoch=1,
        stamp_ns=0,
        tick=tick,
        scenario="",
        lanes=lanes,
        rows=np.array(scene.rows, np.float32).tobytes(),
        target_lane=scene.lane,
        target_speed_mps=scene.target_speed,
        previous_lane=scene.previous,
        sight_m=SIGHT_M,
    )


class Failing:
    """The shipped policy, but for the ticks at which it has something else to say."""

    def __init__(self) -> None:
        self._policy = load_policy()
        self.instead: Sequence[float] | None = None

    def logits(self, x):
        return self._policy.logits(x) if self.instead is None else np.array(self.instead)


@pytest.fixture(scope="module")
def failing() -> Failing:
    return Failing()


@settings(max_examples=400, deadline=None)
@given(
    presets,
    st.lists(
        st.tuples(
            scenes(),
            directives,
            st.none() | st.sampled_from(BROKEN) | st.tuples(*[st.floats(-5, 5)] * 5),
            st.integers(1, 20),
            st.integers(0, 40),
        ),
        min_size=1,
        max_size=3,
    ),
)
def test_whatever_state_directive_and_policy_the_node_does_what_a_fresh_look_of_the_mask_leaves_open(
    failing, preset, ticks
):
    node, tick = FastNode(FastConfig(), failing, PRESETS[preset]), 0
    for scene, directive, instead, passed, now_s in ticks:
        failing.instead, tick = instead, tick + passed
        seen = seen_at(tick, scene)
        action, _ = node.step(seen, directive, now_s * 10**9)
        rule, _ = judge(
            rows_of(seen).tolist(),
            lane_table(seen.lanes),
            scene.target_speed,
            scene.lane,
            scene.previous,
            PRESETS[preset],
        )
        nothing_open = all(r != OPEN for r in rule[:5])
        assert rule[action.meta_action] == OPEN, action
        assert (action.meta_action == MetaAction.EMERGENCY_BRAKE) == nothing_open, action
        assert action.source != "fallback" or instead in BROKEN, action


def narrowed(
    rows,
    target_speed: float,
    wish_lane: int,
    wish_mps: float = 28.0,
    headway_s: float = 1.0,
    lane: int = 1,
    previous: int = -1,
) -> set[int]:
    rule, near = [OPEN] * 6, [0] * 12
    survey(rows, HIGHWAY, near)
    narrow(rule, rows, near, HIGHWAY, target_speed, lane, previous, wish_lane, wish_mps, headway_s)
    return {a for a in range(5) if rule[a] == NOT_WISHED}


def test_giving_up_the_way_home_is_not_narrowed_down_to_braking():
    beside = [car(0, 500, 0, 0, y=0.0), car(11, 499, 1, 0, y=3.0)]
    rule, _ = judge(beside, LANES, 0.0, 1, 0, PRESETS["cautious"])
    near = [0] * 6
    survey(beside, LANES, near)
    narrow(rule, beside, near, LANES, 0.0, 1, 0, -1, 0.0, 1.0)
    assert [a for a in range(5) if rule[a] == OPEN] == [MetaAction.LEFT]


def test_an_open_change_to_the_wished_lane_is_all_that_is_left():
    assert narrowed([car(0, 500, 1, 20)], 20.0, 3) == set(range(5)) - {MetaAction.RIGHT}


def test_nobody_leaves_the_wished_lane_or_drives_faster_than_wished():
    assert narrowed([car(0, 500, 1, 20)], 20.0, 1, 20.0) == {MetaAction.SPEED_UP, MetaAction.LEFT, MetaAction.RIGHT}
    assert MetaAction.CRUISE in narrowed([car(0, 500, 1, 20)], 20.0, 1, 15.0)


def test_the_wished_headway_limits_the_speed_behind_a_leader():
    rows = [car(0, 500, 1, 20), car(1, 535, 1, 20)]  # 30 m, 1.5 s
    assert MetaAction.CRUISE not in narrowed(rows, 20.0, 1, 28.0, 1.0)
    assert MetaAction.CRUISE in narrowed(rows, 20.0, 1, 28.0, 2.5)


def test_a_change_that_can_go_on_is_not_given_up():
    assert MetaAction.RIGHT in narrowed([car(0, 500, 1, 20)], 20.0, -1, lane=1, previous=2)


def test_the_lateral_distance_is_that_of_two_cars_that_react_and_then_brake():
    # 0.2 s from 1.0 to 1.1 m/s: 0.21 m, then 1.1^2 / 4 m; the other from 0 to 0.1 m/s: 0.01 m, then 0.1^2 / 4 m.
    assert measures.rss_lateral_m(1.0, 0.0, 0.2, 0.5, 2.0, 0.3) == pytest.approx(0.3 + 0.21 + 0.3025 + 0.01 + 0.0025)


def test_cars_that_move_apart_need_only_the_room_to_sway():
    assert measures.rss_lateral_m(-1.0, 0.5, 0.2, 0.0, 2.0, 0.3) == 0.3


@pytest.mark.parametrize(("drift", "in_the_way"), [(0.25, True), (0.0, False), (-0.25, False)])
def test_a_car_ahead_in_the_next_lane_is_in_the_way_where_it_drifts_towards_the_ego(drift: float, in_the_way: bool):
    rows = [car(0, 500, 2, 20), car(4, 508, 1, 20, y=5.65)]
    rows[1][4] = drift
    assert (closed_on(HIGHWAY, rows, 2).get(MetaAction.CRUISE) == "lead too close") == in_the_way


@given(presets, st.floats(3.0, 33.0), st.integers(1, 40))
def test_the_ego_brakes_sideways_as_the_mask_takes_it_to(preset, speed, ticks):
    p = PRESETS[preset]
    ego = Ego(500.0, 8.0, speed, 0.0, 0.0, speed, 2, -1)
    for k in range(ticks):
        ego = ego.moved(int(MetaAction.LEFT if k == 0 else MetaAction.CRUISE), HIGHWAY, 40.0)
    assume(ego.previous == 2)
    start, towards = ego.y, -ego.row(HIGHWAY)[4]
    ego = ego.moved(int(MetaAction.RIGHT), HIGHWAY, 40.0)
    nearest = ego.y
    for _ in range(45):
        ego = ego.moved(int(MetaAction.CRUISE), HIGHWAY, 40.0)
        nearest = min(nearest, ego.y)
    assert start - nearest <= measures.rss_lateral_m(towards, 0.0, p.reaction_s, p.side_accel, p.side_brake, 0.0)


def test_a_car_that_stands_askew_is_as_wide_as_it_is():
    rows = [car(0, 500, 1, 10), car(1, 515, 2, 0, y=7.0)]
    assert MetaAction.CRUISE not in closed_on(RAMP, rows, 1)
    rows[1][5] = 0.9
    assert MetaAction.CRUISE in closed_on(RAMP, rows, 1)


def test_a_change_is_completed_when_going_back_would_not_stop_before_the_lane_ends():
    close_behind = car(4, 318, 1, 20)
    there = closed_on(RAMP, [car(0, 330, 2, 14, y=6.5), close_behind], 1, previous=2)
    assert (there.get(MetaAction.CRUISE), there.get(MetaAction.RIGHT)) == (None, "lane ends")
    before = closed_on(RAMP, [car(0, 300, 2, 14, y=6.5), car(4, 288, 1, 20)], 1, previous=2)
    assert (before.get(MetaAction.CRUISE), before.get(MetaAction.RIGHT)) == ("give up the change", None)


def test_a_change_is_completed_when_a_car_has_come_up_in_the_lane_that_is_mostly_left():
    rows = [car(0, 500, 1, 15, y=5.8), car(4, 480, 1, 28), car(5, 494, 2, 15)]
    shut = closed_on(HIGHWAY, rows, 1, previous=2)
    assert (shut.get(MetaAction.CRUISE), shut.get(MetaAction.RIGHT)) == (None, "rear gap in lane")


BEHAVIOUR = {"mask/7": "f673803ac4d68448"}
"""What the mask of a version does. A policy learns behind one mask and is driven behind no other."""


def test_the_mask_does_what_its_version_names():
    assert {VERSION: mask_behaviour.digest()} == BEHAVIOUR, "the mask behaves differently: bump VERSION and train anew"


@settings(max_examples=400, deadline=None)
@given(scenes(), presets)
def test_the_compiled_mask_of_training_closes_what_the_driving_mask_closes(scene, preset):
    import numba

    from fast_node.training import rollout

    assert isinstance(rollout._close, numba.core.registry.CPUDispatcher)
    rule, vehicle, near = np.zeros(6, np.int64), np.zeros(6, np.int64), np.zeros(3 * len(scene.lanes), np.int64)
    rollout._close(
        np.array(scene.rows),
        np.array(scene.lanes),
        scene.target_speed,
        scene.lane,
        scene.previous,
        SIGHT_M,
        near,
        rule,
        vehicle,
        PRESETS[preset],
    )
    assert (rule.tolist(), vehicle.tolist()) == judge(
        scene.rows, scene.lanes, scene.target_speed, scene.lane, scene.previous, PRESETS[preset]
    )


DT = 1 / 15
Motion = Callable[[float], tuple[float, float]]
"""Time [s] to where a car is [m] and its speed [m/s], both along the road."""


def braking(x: float, v: float, brake: float, reaction_s: float = 0.0, accel: float = 0.0) -> Motion:
    """A car that accelerates until it reacts, and then brakes to a standstill."""

    def at(t: float) -> tuple[float, float]:
        early = min(t, reaction_s)
        peak = v + accel * early
        late = min(t - early, peak / brake)
        return x + v * early + 0.5 * accel * early**2 + peak * late - 0.5 * brake * late**2, peak - brake * late

    return at


def steady(x: float, v: float) -> Motion:
    return lambda t: (x + v * t, v)


class Ego(NamedTuple):
    x: float
    y: float
    speed: float
    heading: float
    accel: float
    target_speed: float
    lane: int
    previous: int

    def moved(self, meta: int, lanes, speed_ceiling: float) -> Ego:
        """One tick later, as the simulator's executor and bicycle model have it."""
        gates = [(b[1], b[2], b[6], b[7]) for b in lanes]
        target, lane, previous = executor.edit_set_points(
            meta, self.target_speed, self.lane, self.previous, gates, self.x, math.nan, 0.0, speed_ceiling
        )
        accel = executor.acceleration_command(self.speed, target, self.accel, meta, DT)
        steering = executor.steering_command(self.y, self.heading, self.speed, lanes[lane][0], 0.0)
        slip = math.atan(0.5 * math.tan(steering))
        y = self.y + self.speed * math.sin(self.heading + slip) * DT
        if previous >= 0 and executor.change_finished(y, lanes[lane][0]):
            previous = -1
        return Ego(
            self.x + self.speed * math.cos(self.heading + slip) * DT,
            y,
            self.speed + accel * DT,
            self.heading + self.speed * math.sin(slip) / 2.5 * DT,
            accel,
            target,
            lane,
            previous,
        )

    def row(self, lanes) -> list[float]:
        return [
            0.0,
            self.x,
            self.y,
            self.speed * math.cos(self.heading),
            self.speed * math.sin(self.heading),
            self.heading,
            5.0,
            2.0,
            float(nearest_lane(lanes, self.y)),
        ]


def ahead_by(
    seconds: float,
    ego: Ego,
    lanes,
    others: Sequence[tuple[int, Motion]],
    first: int,
    liking: Sequence[int],
    preset: Preset,
) -> Iterator[tuple[Ego, list[list[float]]]]:
    """What becomes of `first` and then, at each tick, of the most liked action that the mask leaves open: the ego and
    all rows after every tick. Nothing, if the mask closes `first`. others: (lane, motion); who is out of sight is not
    seen."""
    for tick in range(round(seconds / DT)):
        rows = rows_at(tick * DT, ego, lanes, others)
        seen = [r for r in rows if abs(r[1] - ego.x) <= SIGHT_M]
        rule, _ = judge(seen, lanes, ego.target_speed, ego.lane, ego.previous, preset)
        if tick == 0 and rule[first] != OPEN:
            return
        meta = first if tick == 0 else next((a for a in liking if rule[a] == OPEN), MetaAction.EMERGENCY_BRAKE)
        ego = ego.moved(int(meta), lanes, lanes[-1][5])
        yield ego, rows_at((tick + 1) * DT, ego, lanes, others)


def rows_at(t: float, ego: Ego, lanes, others) -> list[list[float]]:
    return [ego.row(lanes), *(car(i, at(t)[0], lane, at(t)[1]) for i, (lane, at) in enumerate(others, 1))]


def touched(rows) -> list[int]:
    """Ids of the cars that the ego overlaps."""
    ego = rows[0]
    return [
        int(r[0]) for r in rows[1:] if abs(r[1] - ego[1]) < 5.0 and abs(r[2] - ego[2]) < half_width(r) + half_width(ego)
    ]


LEFT, RIGHT = MetaAction.LEFT, MetaAction.RIGHT
EAGER = (MetaAction.SPEED_UP, MetaAction.CRUISE, MetaAction.SLOW_DOWN)
likings = st.just(EAGER) | st.permutations(range(5))
speeds, accels = st.floats(0, 28), st.floats(-3, 3)
every_preset = pytest.mark.parametrize("preset", sorted(PRESETS))
either_side = pytest.mark.parametrize("side", [MetaAction.LEFT, MetaAction.RIGHT], ids=["left", "right"])


def in_lane(lane: int, v: float, accel: float = 0.0, x: float = 500.0, extra: float = 0.0) -> Ego:
    return Ego(x, 4.0 * lane, v, 0.0, accel, max(v + extra, 0.0), lane, -1)


@every_preset
@settings(max_examples=200, deadline=None)
@given(speeds, speeds, st.floats(0.1, 120), accels, st.floats(-3, 3), st.sampled_from(EAGER), likings)
def test_after_any_open_action_the_mask_can_still_avoid_a_lead_that_brakes_fully(
    preset, v, lead_v, gap, accel, extra, first, liking
):
    p = PRESETS[preset]
    lead = (1, braking(505.0 + gap, lead_v, p.lead_brake))
    for _, rows in ahead_by(4.0, in_lane(1, v, accel, extra=extra), HIGHWAY, [lead], first, liking, p):
        assert not touched(rows)


@every_preset
@either_side
@settings(max_examples=200, deadline=None)
@given(speeds, speeds, speeds, st.floats(0.1, 80), st.floats(0.1, 80), accels, likings)
def test_after_an_open_change_the_leads_of_both_lanes_may_brake_fully(
    preset, side, v, lead_v, other_v, gap, other_gap, accel, liking
):
    p, aim = PRESETS[preset], 1 if side == MetaAction.LEFT else 3
    leads = [(2, braking(505.0 + gap, lead_v, p.lead_brake)), (aim, braking(505.0 + other_gap, other_v, p.lead_brake))]
    for _, rows in ahead_by(4.0, in_lane(2, v, accel), HIGHWAY, leads, side, liking, p):
        assert not touched(rows)


@either_side
def test_after_an_open_change_going_back_behind_a_lead_that_brakes_fully_is_not_all_that_is_left(side):
    lead, back = (2, braking(525.0, 20.0, SIM.lead_brake)), LEFT + RIGHT - side
    for _, rows in ahead_by(4.0, in_lane(2, 20.0), HIGHWAY, [lead], side, (*EAGER, back), SIM):
        assert not touched(rows)


@every_preset
@pytest.mark.parametrize(
    ("road", "side"), [("highway", MetaAction.LEFT), ("highway", MetaAction.RIGHT), ("merge", MetaAction.LEFT)]
)
@settings(max_examples=200, deadline=None)
@given(speeds, speeds, st.floats(-120, -0.1))
def test_after_an_open_change_a_follower_that_reacts_late_does_not_reach_the_ego_that_brakes(
    preset, road, side, v, other_v, behind
):
    p, lanes, x = PRESETS[preset], ROADS[road], 260.0
    rows = [car(0, x, 2, v), car(1, x - 5.0 + behind, 1 if side == MetaAction.LEFT else 3, other_v)]
    rule, _ = judge(rows, lanes, v, 2, preset=p)
    assume(rule[side] == OPEN)
    late = p.follower_reaction_s + FOLLOWER_BLIND_S * max(0.0, 1.0 - v / CREEP_MPS)
    ego, follower = braking(x, v, p.ego_brake), braking(x - 5.0 + behind, other_v, p.follower_brake, late, 0.5)
    assert all(ego(k / 30)[0] - follower(k / 30)[0] > 5.0 for k in range(300))


@every_preset
@settings(max_examples=200, deadline=None)
@given(st.floats(0, 8), st.floats(0, 8), st.floats(0.1, 40), st.floats(20, 400), accels, likings)
def test_after_an_open_pass_nobody_meets_an_oncoming_car_that_comes_at_its_limit(
    preset, v, lead_v, gap, meeting_gap, accel, liking
):
    p = PRESETS[preset]
    others = [(1, steady(505.0 + gap, lead_v)), (0, steady(505.0 + meeting_gap, -LANES[0][5]))]
    for _, rows in ahead_by(2.0, in_lane(1, v, accel), LANES, others, MetaAction.LEFT, liking, p):
        assert not touched(rows)


@every_preset
@settings(max_examples=100, deadline=None)
@given(st.floats(0, 8), st.floats(0, 8), st.floats(0.1, 40), st.floats(20, 400), accels)
def test_an_open_pass_is_over_before_an_oncoming_car_at_its_limit_arrives(preset, v, lead_v, gap, meeting_gap, accel):
    p = PRESETS[preset]
    others = [(1, steady(505.0 + gap, lead_v)), (0, steady(505.0 + meeting_gap, -LANES[0][5]))]
    home = (MetaAction.RIGHT, *EAGER)
    for _, rows in ahead_by(30.0, in_lane(1, v, accel), LANES, others, MetaAction.LEFT, home, p):
        assert not touched(rows)


@every_preset
@settings(max_examples=200, deadline=None)
@given(
    st.floats(230, 349),
    st.floats(0, 20),
    accels,
    st.sampled_from([*EAGER, MetaAction.LEFT]),
    likings,
    st.lists(st.tuples(st.floats(-60, 100), st.floats(0, 20)), max_size=3),
)
def test_after_any_open_action_nobody_drives_over_the_end_of_the_ramp(preset, x, v, accel, first, liking, others):
    p = PRESETS[preset]
    main = [(1, steady(x + dx, speed)) for dx, speed in others]
    for ego, _ in ahead_by(6.0, in_lane(2, v, accel, x), RAMP, main, first, liking, p):
        assert ego.x < RAMP[2][2] or ego.y < RAMP[2][0] - OUT_M + 0.3
