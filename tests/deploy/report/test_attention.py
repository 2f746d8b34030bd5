"""Whom the policy's heads look at."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.record.moments import Moment, moments
from deploy.record.reader import open_recording
from deploy.report.attention import (
    AHEAD,
    BEHIND,
    FARTHER,
    FOLLOWER,
    ITSELF,
    LEADER,
    ONCOMING,
    Look,
    findings_of,
    looks_of,
    role_of,
    summed_up,
)
from schemas.wire.codec import rows_of
from tests.recordings import driven, write
from tests.scenes import HIGHWAY, TWO_WAY, car, observation


def test_everybody_around_the_ego_has_one_role():
    seen = observation(
        car(0, 500, 1, 25), car(1, 540, 1, 24), car(2, 590, 1, 24), car(3, 470, 1, 25), car(4, 520, 0, 27),
        car(5, 490, 2, 22), car(6, 510, 3, 20), lanes=HIGHWAY,
    )  # fmt: skip
    rows = rows_of(seen)
    assert [role_of(rows, k, 1) for k in range(1, 7)] == [LEADER, FARTHER, FOLLOWER, AHEAD, BEHIND, FARTHER]
    assert [role_of(rows, k, 2) for k in (1, 5, 6)] == [AHEAD, FOLLOWER, AHEAD]  # while it changes to lane 2


def test_who_comes_towards_the_ego_is_oncoming_in_any_lane():
    rows = rows_of(observation(car(0, 500, 1, 7), car(1, 560, 0, -7), lanes=TWO_WAY))
    assert role_of(rows, 1, 1) == ONCOMING


def test_the_looks_at_a_recording_are_the_policys_own_and_whole(tmp_path):
    recording = open_recording(write(tmp_path / "a.mcap", driven(3.0, scenario="highway")))
    seen = list(moments(recording))
    looks = looks_of(recording, seen)
    assert len(looks) == len(seen) == 45
    for look in looks:
        assert look.roles[0] == ITSELF
        assert np.allclose(look.weights.sum(axis=1), 1.0, atol=1e-5)
        assert look.weights.shape == (2, 1 + len(look.rows))


def look(*weights: list[float], roles: tuple[str, ...]) -> Look:
    moment = Moment(0.0, observation(car(0, 500, 1, 25)))
    return Look(moment, np.array(weights, np.float32), tuple(range(1, len(roles))), roles)


ROLES = (ITSELF, LEADER, AHEAD, FARTHER)


def test_shares_and_times_an_equal_part_are_means_over_the_ticks_that_have_one():
    one = look([0.5, 0.3, 0.1, 0.1], [0.0, 0.2, 0.8, 0.0], roles=ROLES)
    none = look([1.0], [1.0], roles=(ITSELF,))
    found = summed_up([one, none])
    assert found[LEADER].ticks == 1
    assert found[LEADER].share == pytest.approx((0.3, 0.2))
    assert (found[LEADER].equal, found[ITSELF].equal) == (0.25, pytest.approx(0.625))
    assert found[LEADER].times == pytest.approx(
        (1.8, 0.6)
    )  # of what is for cars: 0.6 of the rest, where a third is equal
    assert found[LEADER].whole == pytest.approx((0.15, 0.1))


@pytest.mark.parametrize(
    ("second", "said"), [([0.0, 0.1, 0.8, 0.1], "So it is true here"), ([0.0, 0.8, 0.1, 0.1], "So it is not true here")]
)
def test_it_is_said_whether_one_head_watches_the_leader_and_another_the_neighbours(second, said):
    looks = [look([0.2, 0.6, 0.1, 0.1], second, roles=ROLES)] * 20
    assert said in findings_of(summed_up(looks))[-1]


def test_nothing_is_claimed_of_whom_is_hardly_seen():
    looks = [look([0.5, 0.5], [0.5, 0.5], roles=(ITSELF, FARTHER))] * 20
    assert "not both seen" in findings_of(summed_up(looks))[-1]
    assert "Too few cars" in findings_of(summed_up([look([1.0], [1.0], roles=(ITSELF,))] * 20))[0]
