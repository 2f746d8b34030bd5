"""No rule can be evaded by alternating actions: whatever is done of what the mask leaves open, tick after tick."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fast_node.mask import OPEN, PRESETS, Preset
from fast_node.mask.entering import CREEP_MPS, FOLLOWER_BLIND_S
from fast_node.mask.lane_end import OUT_M
from schemas.driving.measures import rss_opposite_m
from schemas.driving.road import LANE_END, LANE_LIMIT, LANE_RAMP, LANE_Y, X
from schemas.wire.messages import MetaAction
from tests.mask_scenes import DT, RAMP, ROADS, SIGHT_M, Ego, capped, closed, every_preset, touched
from tests.scenes import car

MOOD_TICKS = 5
ONCOMING_M, ALONG_M = 3.0, 5.0
"""What an oncoming car keeps beyond RSS, as the mask has it; centre to centre of two that touch."""


@dataclass
class Other:
    """The worst that a car is taken to do: ahead of the ego it speeds up and brakes as it likes, behind the ego it
    drives on until it must react, facing the ego it comes at its speed until RSS has it brake."""

    lane: int
    x: float
    speed: float
    moods: list[float]
    """Acceleration [m/s2] of every `MOOD_TICKS`, where it is ahead; lower ones than the preset's are the preset's."""
    way: int = 1
    reacts_at: float = math.inf
    cut_in: bool = False
    """The ego has come into its lane, before it."""

    def row(self, number: int) -> list[float]:
        return car(number, self.x, self.lane, self.way * self.speed)

    def move(self, tick: int, ego: Ego, lanes, p: Preset) -> None:
        room = ego.y - lanes[self.lane][LANE_Y]
        in_its_lane = ego.lane == self.lane or abs(room) < 3.0
        if self.way < 0:
            need = rss_opposite_m(ego.speed, self.speed, p.reaction_s, 0.0, p.follower_brake, p.ego_brake)
            must = in_its_lane and 0.0 < self.x - ego.x < need + ONCOMING_M + ALONG_M
            accel, late = 0.0, p.reaction_s
        elif self.x < ego.x:
            must = in_its_lane
            accel = 0.5 if must else 0.0
            late = p.follower_reaction_s + FOLLOWER_BLIND_S * max(0.0, 1.0 - ego.speed / CREEP_MPS)
        else:
            must, late, accel = False, 0.0, max(self.moods[tick // MOOD_TICKS], -p.lead_brake)
        self.reacts_at = min(self.reacts_at, tick + late / DT) if must else math.inf
        if tick >= self.reacts_at:
            accel = -p.follower_brake
        accel = max(accel, -self.speed / DT)
        if accel > 0.0 and self.speed > lanes[self.lane][LANE_LIMIT]:
            accel = 0.0
        self.x += self.way * (self.speed + 0.5 * accel * DT) * DT
        self.speed = max(self.speed + accel * DT, 0.0)


def drive(ego: Ego, others: list[Other], picks: list[int], lanes, p: Preset) -> int:
    """Do at every tick the open action that `picks` picks; fail where the ego touches somebody and it is its fault.
    Returns for how many ticks it went on: none where somebody is too near at first.

    It is not the ego's where it is run into by a car behind, unless it has come in before that car, and has not had to
    brake harder since than it shows.
    """
    gentle = True
    for tick, pick in enumerate(picks):
        rows = [ego.row(lanes), *(other.row(i) for i, other in enumerate(others, 1))]
        seen = [r for r in rows if abs(r[X] - ego.x) <= SIGHT_M]
        reasons, _, cap = capped(seen, lanes, ego.target_speed, ego.lane, ego.previous, p)
        opened = [a for a in range(5) if reasons[a] == OPEN]
        if tick == 0 and (touched(rows) or not {MetaAction.CRUISE, MetaAction.SPEED_UP} & set(opened)):
            return 0
        before, ahead = ego, [other.x > ego.x for other in others]
        ego = ego.moved(opened[pick % len(opened)] if opened else MetaAction.EMERGENCY_BRAKE, lanes, 28.0, cap)
        gentle = gentle and ego.accel >= -p.shown_brake - 1e-9
        for other in others:
            other.cut_in = other.cut_in or (ego.lane == other.lane != before.lane)
            other.move(tick, ego, lanes, p)
        rows = [ego.row(lanes), *(other.row(i) for i, other in enumerate(others, 1))]
        for number in touched(rows):
            behind = others[number - 1].way > 0 and not ahead[number - 1]
            its_own_fault = behind and not (gentle and others[number - 1].cut_in)
            assert its_own_fault, (tick, number)
            return tick
        end = lanes[-1]
        assert ego.x < end[LANE_END] or end[LANE_RAMP] == 0.0 or ego.y < end[LANE_Y] - OUT_M + 0.3
    return len(picks)


SECONDS = {"highway": 5.0, "merge": 6.0, "two-way": 14.0}


@st.composite
def situations(draw: st.DrawFn, road: str) -> tuple[Ego, list[Other], list[int]]:
    """The ego somewhere on the road, not yet in anybody's way, and what everybody is going to do."""
    ticks = round(SECONDS[road] / DT)
    lanes = ROADS[road]
    top = draw(st.sampled_from([5.0, lanes[-1][LANE_LIMIT]]))
    lane = {"highway": draw(st.sampled_from([1, 2])), "merge": 2, "two-way": 1}[road]
    x, v = draw(st.floats(235.0, 345.0)) if road == "merge" else 500.0, draw(st.floats(0.0, top))
    ego = Ego(x, 4.0 * lane, v, 0.0, draw(st.floats(-3.0, 1.8)), max(v + draw(st.floats(-3, 3)), 0.0), lane, -1)
    moods = st.lists(
        st.sampled_from([-9.5, -2.0, 0.0, 0.0, 2.0]), min_size=ticks // MOOD_TICKS + 1, max_size=ticks // MOOD_TICKS + 1
    )
    reach = draw(st.sampled_from([15.0, 60.0]))
    others = []
    for k in range(len(lanes)):
        if lanes[k][LANE_RAMP] > 0.0 or abs(k - lane) > 1:
            continue
        if road == "two-way" and k == 0:
            far = draw(st.lists(st.floats(15.0, 420.0), max_size=2))
            others += [Other(k, x + away, draw(st.floats(0.0, 8.0) | st.just(8.0)), [], -1) for away in far]
            continue
        front = x
        for gap in draw(st.lists(st.floats(0.1, reach), max_size=2)):
            front += 5.0 + gap
            others.append(Other(k, front, draw(st.floats(0.0, top)), draw(moods)))
        if k != lane and draw(st.booleans()):
            others.append(Other(k, x - 5.0 - draw(st.floats(0.1, reach)), draw(st.floats(0.0, 1.2 * top)), draw(moods)))
    picks = draw(st.lists(st.integers(0, 59), min_size=ticks, max_size=ticks))
    return ego, others, picks


@every_preset
@settings(max_examples=100)
@pytest.mark.parametrize("road", sorted(SECONDS))
@given(data=st.data())
def test_no_sequence_of_open_actions_leads_to_a_collision_that_is_the_ego_s_fault(preset, road, data):
    ego, others, picks = data.draw(situations(road))
    assume(drive(ego, others, picks, ROADS[road], PRESETS[preset]))


def test_nobody_pulls_out_beside_a_car_that_stands_in_the_oncoming_lane():
    rows = [car(0, 500, 1, 5), car(1, 520, 1, 4), car(2, 497, 0, 0.0)]
    assert closed(rows)[MetaAction.LEFT] == "rear gap in lane"
    assert closed([*rows[:2], car(2, 503, 0, 0.0)])[MetaAction.LEFT] == "front gap in lane"


def test_a_change_off_the_ramp_that_is_taken_back_and_forth_does_not_end_beyond_the_ramp():
    ego = Ego(300.0, 8.0, 8.0, 0.0, 0.0, 8.0, 2, -1)
    assert drive(ego, [], [59] * 120, RAMP, PRESETS["sim"]) == 120
