"""Tracks: exact where the observation is, patient where it misses a car, calm where it is noisy."""

from __future__ import annotations

import numpy as np
import pytest

from fast_node.tracks import Tracks
from schemas.driving.intent import intended_lane
from schemas.driving.road import DOUBT_VX, DOUBT_X, ID, LANE, VX, X, Y, lane_table
from schemas.driving.tracks import GHOST_S, REMEMBER_S
from tests.scenes import HIGHWAY, TWO_WAY, Row, car, observation

HZ = 15


def drive(
    tracks: Tracks, ticks: range, *cars: Row, missing=lambda tick: (), noise=None, lanes=TWO_WAY, epoch=1, sight=200
):
    """Even motion for so many ticks; returns the tracks and the true rows after the last."""
    for tick in ticks:
        rows = [[*row[:X], row[X] + row[VX] * tick / HZ, *row[Y:]] for row in cars]
        seen = [list(row) for row in rows if row[ID] not in missing(tick)]
        if noise is not None:
            for row in seen[1:]:
                row[X], row[Y] = (row[k] + noise.normal(0.0, 1.0) for k in (X, Y))
                row[VX], row[VX + 1] = (row[k] + noise.normal(0.0, 0.5) for k in (VX, VX + 1))
        message = observation(*seen, lanes=lanes, tick=tick, epoch=epoch, sight_m=sight)
        found = tracks.follow(message, seen, lane_table(lanes))
    return found, rows


def numbers(found: list[list[float]]) -> list[int]:
    return [int(t[ID]) for t in found]


EGO, LEAD = car(0, 500, 1, 8.0), car(7, 530, 1, 5.0)


def test_what_is_exact_stays_as_it_is_to_the_last_bit_and_in_no_doubt() -> None:
    rows = np.random.default_rng(3).uniform(0.0, 1.0, (200, 2))
    tracks, x, v = Tracks(), 530.0, 10.0
    for tick, (brake, _) in enumerate(rows):  # it brakes and speeds up as hard as a car can
        x, v = x + v / HZ, max(v + (12.0 * brake - 6.0) / HZ, 0.0)
        lead = car(7, x, 1, v)
        found = tracks.follow(observation(EGO, lead, tick=tick), [EGO, lead], lane_table(TWO_WAY))
        assert found[1][: LANE + 1] == lead
        assert found[1][DOUBT_X] == found[1][DOUBT_VX] == 0.0


def test_a_missed_car_goes_on_for_a_second_in_growing_doubt_and_is_then_gone() -> None:
    tracks, doubt = Tracks(), 0.0
    drive(tracks, range(10), EGO, LEAD)
    for tick in range(10, 10 + HZ):
        found, rows = drive(tracks, range(tick, tick + 1), EGO, LEAD, missing=lambda _: (7,))
        assert found[1][X] == pytest.approx(rows[1][X])
        assert found[1][ID] == 7
        assert found[1][DOUBT_X] > doubt
        doubt = found[1][DOUBT_X]
    found, _ = drive(tracks, range(10 + HZ, 12 + HZ), EGO, LEAD, missing=lambda _: (7,))
    assert GHOST_S == 1.0
    assert all(t[ID] < 0 for t in found[1:])


def test_a_car_that_is_missed_for_longer_is_not_passed_before_its_motion_says_so() -> None:
    tracks = Tracks()
    drive(tracks, range(10), EGO, LEAD)
    found, _ = drive(tracks, range(10, 10 + 4 * HZ), EGO, LEAD, missing=lambda _: (7,))
    assert intended_lane(found, 1, 7) == 0
    late = 10 + round((REMEMBER_S - 1.0) * HZ)
    found, _ = drive(tracks, range(10 + 4 * HZ, late), EGO, car(7, 500, 1, 5.0), missing=lambda _: (7,))
    found, _ = drive(tracks, range(late, late + 1), car(0, 560, 1, 8.0), missing=lambda _: (7,))
    assert intended_lane(found, 1, 7) == 1


def test_a_car_seen_again_is_where_it_is_seen() -> None:
    found, rows = drive(Tracks(), range(40), EGO, LEAD, missing=lambda tick: (7,) if tick % 3 else ())
    assert found[1][: LANE + 1] == rows[1]


def test_who_leaves_sight_the_road_or_the_world_leaves_no_ghost() -> None:
    tracks = Tracks()
    drive(tracks, range(5), EGO, car(7, 699, 1, 8.0), car(8, 2970, 1, 8.0), car(9, 520, 1, 8.0), sight=1e4)
    assert numbers(drive(tracks, range(5, 6), EGO, sight=199)[0]) == [0, 9]
    assert numbers(drive(tracks, range(6, 7), EGO, epoch=2)[0]) == [0]


def test_a_new_number_at_the_same_place_is_the_same_car() -> None:
    tracks = Tracks()
    drive(tracks, range(10), EGO, LEAD)
    found, rows = drive(tracks, range(10, 20), EGO, car(12, 530, 1, 5.0))
    assert numbers(found) == [0, 7]
    assert found[1][X] == rows[1][X]


def test_a_car_that_jumps_starts_anew_in_doubt_that_fades() -> None:
    tracks = Tracks()
    drive(tracks, range(10), EGO, LEAD)
    found, rows = drive(tracks, range(10, 11), EGO, car(7, 560, 1, 5.0))
    assert numbers(found) == [0, 7]
    assert found[1][X] == rows[1][X]
    assert found[1][DOUBT_X] > 1.0
    assert drive(tracks, range(11, 70), EGO, car(7, 560, 1, 5.0))[0][1][DOUBT_X] == 0.0


def test_noise_is_noticed_and_filtered_and_the_truth_is_within_the_doubt() -> None:
    cars = [car(k, 480 + 12 * k, k % 4, 20.0 + 0.2 * k) for k in range(1, 9)]
    tracks, noise, off, within = Tracks(), np.random.default_rng(5), [], []
    for tick in range(300):
        lost = set(noise.choice(range(1, 9), 2, replace=False))
        found, rows = drive(
            tracks,
            range(tick, tick + 1),
            car(0, 500, 1, 20.0),
            *cars,
            missing=lambda _, lost=lost: lost,
            noise=noise,
            lanes=HIGHWAY,
        )
        truth = {row[ID]: row for row in rows}
        if tick > 3 * HZ:
            for t in found[1:]:
                off.append((t[X] - truth[t[ID]][X], t[VX] - truth[t[ID]][VX]))
                within.append(abs(off[-1][0]) <= t[DOUBT_X] and abs(off[-1][1]) <= t[DOUBT_VX])
    assert tracks.noise == pytest.approx((1.0, 1.0, 0.5, 0.5), rel=0.4)
    assert np.mean(within) > 0.97
    x, v = np.sqrt(np.mean(np.square(off), axis=0))
    assert x < 0.5
    assert v < 0.35
