"""What is measured of an episode, beside numbers computed by hand. A tick is 1/15 s; 900 ticks are a minute."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from schemas.driving.intent import ANY_LANE
from schemas.driving.road import NOBODY
from sim_node.metrics import Recorder, Settled
from sim_node.results import EpisodeResult, summarise
from sim_node.ride import Ride, comfort, obedience, progress, ride_score, safety
from sim_node.scenarios import SCENARIOS
from tests.scenes import Row, car


def drive(
    rows: list[Row],
    ticks: int = 1,
    *,
    recorder: Recorder | None = None,
    accel: float = 0.0,
    target: int = 1,
    previous: int = -1,
    wish_lane: int = ANY_LANE,
    wish_mps: float = 20.0,
    **more: Any,
) -> Recorder:
    """So many ticks of one scene on the highway that look the same."""
    recorder = recorder or Recorder(SCENARIOS["highway"], 1)
    others: dict[str, Any] = {name: np.array([value]) for name, value in more.items()}
    for _ in range(ticks):
        recorder.tick(
            np.array([rows], np.float32),
            np.array([accel]),
            np.array([target]),
            np.array([previous]),
            np.zeros(1, np.bool_),
            np.ones(1, np.bool_),
            np.array([wish_lane]),
            np.array([wish_mps]),
            **others,
        )
    return recorder


def result_of(recorder: Recorder) -> EpisodeResult:
    (result,) = recorder.results()
    return result


EGO = car(0, 100, 1, 20)


def test_a_finished_change_is_one_flip_and_is_not_given_up() -> None:
    recorder = drive([EGO], 2)
    drive([EGO], 10, recorder=recorder, target=0, previous=1)
    drive([car(0, 100, 0, 20)], 2, recorder=recorder, target=0)
    assert (result_of(recorder).lane_flips, result_of(recorder).changes_given_up) == (1, 0)


def test_a_change_that_goes_back_is_two_flips_and_one_given_up_and_taken_up_again_one_flip_more() -> None:
    recorder = drive([EGO])
    drive([EGO], 3, recorder=recorder, target=0, previous=1)
    drive([EGO], 3, recorder=recorder, target=1, previous=0)
    assert (result_of(recorder).lane_flips, result_of(recorder).changes_given_up) == (2, 1)
    drive([EGO], 3, recorder=recorder, target=0, previous=1)
    assert (result_of(recorder).lane_flips, result_of(recorder).changes_given_up) == (3, 1)


def test_a_change_in_the_first_tick_is_a_flip() -> None:
    assert result_of(drive([EGO], target=2, previous=1)).lane_flips == 1


def test_the_acceleration_changes_sign_only_beyond_the_dead_band() -> None:
    recorder = Recorder(SCENARIOS["highway"], 1)
    for accel in (0.5, 0.05, -0.05, 0.05, 0.5, -0.09, -0.2, 0.0, -0.2, 0.11):
        drive([EGO], recorder=recorder, accel=accel)
    assert result_of(recorder).accel_sign_changes == 2  # 0.5 to -0.2, and -0.2 to 0.11


def test_rates_are_of_the_minutes_that_were_driven() -> None:
    recorder = drive([EGO], 450)
    for k in range(4):
        drive([EGO], recorder=recorder, target=(0, 1)[k % 2], previous=(1, 0)[k % 2])
    drive([EGO], 446, recorder=recorder)
    summary = summarise([result_of(recorder)] * 2)
    assert (summary["lane_flips_per_min"], summary["lane_flips_per_min_of"]) == (4.0, 2.0)
    assert summary["changes_given_up_per_min"] == 2.0


def test_a_headway_under_a_second_is_of_the_ticks_behind_a_leader_of_our_direction_within_100_m() -> None:
    near, far = car(1, 100 + 5 + 19, 1, 20), car(1, 100 + 5 + 101, 1, 20)
    recorder = drive([EGO, near], 3)
    drive([EGO, car(1, 100 + 5 + 21, 1, 20)], 1, recorder=recorder)
    drive([EGO, far], 5, recorder=recorder)
    drive([EGO, car(1, 100 + 5 + 10, 1, -20)], 7, recorder=recorder)
    summary = summarise([result_of(recorder)])
    assert (summary["headway_under_1s_share"], summary["headway_under_1s_share_of"]) == (0.75, 4)


def test_the_smallest_time_to_collision_is_told_with_and_without_the_cap() -> None:
    closing, free = result_of(drive([EGO, car(1, 145, 1, 16)])), result_of(drive([EGO]))
    summary = summarise([closing, free])
    assert (summary["min_ttc_mean"], summary["min_ttc_mean_under_cap"], summary["min_ttc_median"]) == (55.0, 10.0, 55.0)
    assert (summary["min_ttc_capped_share"], summary["min_ttc_capped_share_of"]) == (0.5, 2)


def test_a_lane_that_is_wished_is_complied_with_in_it_and_counts_from_the_wish() -> None:
    recorder = drive([EGO], 30, wish_lane=1, asked=False)
    drive([EGO], 15, recorder=recorder, wish_lane=2, asked=True)
    assert math.isnan(result_of(recorder).fulfilled_s)
    drive([car(0, 100, 2, 20)], 1, recorder=recorder, wish_lane=2, target=2, asked=True)
    result = result_of(recorder)
    assert (result.fulfilled_s, result.asked_ticks) == (pytest.approx(16 / 15), 16)
    assert (result.time_to_comply_s, result.in_lane) == (pytest.approx(16 / 15), pytest.approx(1 / 16))


def test_a_speed_that_is_wished_is_complied_with_at_it_or_once_rid_of_the_slower_leader() -> None:
    slow = car(1, 150, 1, 15)
    held_up = drive([EGO, slow], 5, wish_mps=28.0)
    assert math.isnan(result_of(held_up).fulfilled_s)
    drive([car(0, 100, 2, 20), slow], 1, recorder=held_up, wish_mps=28.0, target=2)
    assert result_of(held_up).fulfilled_s == pytest.approx(6 / 15)
    assert result_of(drive([car(0, 100, 1, 27.6)], wish_mps=28.0)).fulfilled_s == pytest.approx(1 / 15)
    assert math.isnan(result_of(drive([EGO, car(1, 150, 2, 15)], 5, wish_mps=28.0)).fulfilled_s)  # not its leader


def test_an_overtake_is_complied_with_behind_the_ego_and_home_again() -> None:
    recorder = drive([EGO, car(4, 130, 1, 10)], pass_id=4)
    drive([car(0, 140, 0, 20), car(4, 130, 1, 10)], recorder=recorder, pass_id=4, target=0)
    assert math.isnan(result_of(recorder).fulfilled_s)
    drive([car(0, 140, 1, 20), car(4, 130, 1, 10)], recorder=recorder, pass_id=NOBODY)
    assert result_of(recorder).fulfilled_s == pytest.approx(3 / 15)


def test_never_complied_is_of_the_episodes_with_a_wish() -> None:
    met, missed = result_of(drive([EGO])), result_of(drive([EGO], wish_lane=3))
    silent = result_of(drive([EGO], asked=False))
    summary = summarise([met, missed, missed, silent])
    assert (summary["never_complied_share"], summary["never_complied_share_of"]) == (pytest.approx(2 / 3), 3)


def test_decisions_are_counted_with_why_the_favourite_was_closed() -> None:
    yes, no = np.ones(1, np.bool_), np.zeros(1, np.bool_)
    recorder = Recorder(SCENARIOS["highway"], 1)
    for settled in (
        Settled(yes, yes, no, no),
        Settled(yes, yes, yes, no),
        Settled(yes, no, no, yes),
        Settled(yes, no, no, yes),
        Settled(no, yes, no, no),
    ):
        recorder.tick(
            np.array([[EGO]], np.float32), np.zeros(1), np.ones(1, int), -np.ones(1, int), no, yes, settled=settled
        )
    summary = summarise(recorder.results())
    assert (summary["decisions"], summary["decisions_with_choice_share"]) == (4, 0.5)
    assert (summary["decisions_closed_by_mask_share"], summary["decisions_closed_by_wish_share"]) == (0.25, 0.5)
    assert summary["decisions_with_choice_share_of"] == 4


def test_a_share_of_nothing_is_not_a_number() -> None:
    summary = summarise([result_of(drive([EGO]))])
    assert math.isnan(summary["decisions_with_choice_share"])
    assert summary["decisions_with_choice_share_of"] == 0


IDEAL = Ride(
    own_fault=False,
    success=True,
    min_ttc_s=100.0,
    close_share=0.0,
    jerk_rms=0.0,
    accel_rms=0.0,
    accel_sign_changes_per_min=0.0,
    changes_given_up_per_min=0.0,
    progress=1.0,
    asked=True,
    fulfilled_s=0.0,
    speed_kept=1.0,
    headway_kept=math.nan,
)


def test_an_ideal_ride_has_a_score_of_100() -> None:
    assert ride_score(IDEAL) == pytest.approx(100.0)


def test_a_collision_of_ones_own_fault_takes_everything() -> None:
    assert ride_score(replace(IDEAL, own_fault=True, min_ttc_s=0.0)) == 0.0


def test_a_ride_score_is_the_hand_computed_one() -> None:
    ride = Ride(
        own_fault=False,
        success=True,
        min_ttc_s=4.0,
        close_share=0.1,
        jerk_rms=1.5,
        accel_rms=1.0,
        accel_sign_changes_per_min=2.0,
        changes_given_up_per_min=3.0,
        progress=0.9,
        asked=True,
        fulfilled_s=20.0,
        speed_kept=0.7,
        headway_kept=0.9,
    )
    assert safety(ride) == pytest.approx(0.75 * 0.95)
    assert comfort(ride) == pytest.approx((0.5 + 0.5 + 0.75 + 0.25) / 4)
    assert progress(ride) == pytest.approx(0.8)
    assert obedience(ride) == pytest.approx((0.5 + 0.7 + 0.9) / 3)
    assert ride_score(ride) == pytest.approx(100 * 0.7125 * (0.35 * 0.5 + 0.35 * 0.8 + 0.3 * 0.7))
    assert ride_score(replace(ride, success=False)) == pytest.approx(0.4 * ride_score(ride))


def test_a_wish_that_is_never_fulfilled_and_half_of_the_wished_speed_earn_nothing() -> None:
    assert obedience(replace(IDEAL, fulfilled_s=math.nan, speed_kept=math.nan)) == 0.0
    assert progress(replace(IDEAL, progress=0.5)) == 0.0


def test_without_words_nothing_was_asked_and_standing_still_on_request_is_progress() -> None:
    assert obedience(replace(IDEAL, asked=False, fulfilled_s=math.nan)) == 1.0
    assert progress(replace(IDEAL, progress=math.nan)) == 1.0


def test_the_interval_of_the_ride_score_is_the_normal_one_over_the_episodes() -> None:
    one = result_of(drive([EGO]))
    summary = summarise([replace(one, ride_score=score) for score in (50.0, 60.0, 70.0, 80.0)])
    half = 1.96 * math.sqrt((15**2 + 5**2 + 5**2 + 15**2) / 3) / 2
    assert summary["ride_score"] == 65.0
    assert (summary["ride_score_low"], summary["ride_score_high"]) == pytest.approx((65.0 - half, 65.0 + half))
