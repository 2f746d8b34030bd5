"""The intent."""

from __future__ import annotations

from schemas.driving.intent import intended_lane
from tests.mask_scenes import car


def test_the_wished_lane_is_the_oncoming_one_until_the_lead_is_passed():
    lead = car(3, 510, 1, 4)
    assert [intended_lane([car(0, x, 1, 6), lead], 1, 3) for x in (400, 495, 512, 520)] == [1, 0, 0, 1]
