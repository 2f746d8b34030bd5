"""Distances, by hand."""

from __future__ import annotations

import pytest

from schemas.driving import measures


def test_the_lateral_distance_is_that_of_two_cars_that_react_and_then_brake():
    # 0.2 s from 1.0 to 1.1 m/s: 0.21 m, then 1.1^2 / 4 m; the other from 0 to 0.1 m/s: 0.01 m, then 0.1^2 / 4 m.
    assert measures.rss_lateral_m(1.0, 0.0, 0.2, 0.5, 2.0, 0.3) == pytest.approx(0.3 + 0.21 + 0.3025 + 0.01 + 0.0025)


def test_cars_that_move_apart_need_only_the_room_to_sway():
    assert measures.rss_lateral_m(-1.0, 0.5, 0.2, 0.0, 2.0, 0.3) == 0.3
