"""The mask as a whole."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from fast_node.mask import OPEN, PRESETS, REASONS, VERSION, close_actions
from schemas.driving.road import ID
from schemas.runtime.compiled import compiled
from schemas.wire.messages import MetaAction
from tests import mask_behaviour
from tests.mask_scenes import SIGHT_M, capped, judge, presets, scenes


@settings(max_examples=300, deadline=None)
@given(scenes(), presets)
def test_emergency_braking_is_always_open_and_every_closure_has_a_rule_and_a_vehicle_that_is_there(scene, preset):
    reasons, vehicle = judge(scene.rows, scene.lanes, scene.target_speed, scene.lane, scene.previous, PRESETS[preset])
    seen = {int(row[ID]) for row in scene.rows[1:]}
    assert reasons[MetaAction.EMERGENCY_BRAKE] == OPEN
    assert all(REASONS[r] for r in reasons if r != OPEN)
    assert all(v == -1 or (r != OPEN and v in seen) for r, v in zip(reasons, vehicle, strict=True))


BEHAVIOUR = {"mask/8": "933dc51a92c317bd"}
"""What the mask of a version does. A policy learns behind one mask and is driven behind no other."""


def test_the_mask_does_what_its_version_names():
    assert {VERSION: mask_behaviour.digest()} == BEHAVIOUR, "the mask behaves differently: bump VERSION and train anew"


COMPILED = compiled(close_actions)


@settings(max_examples=400, deadline=None)
@given(scenes(), presets)
def test_the_compiled_mask_of_training_closes_what_the_driving_mask_closes(scene, preset):
    reasons, vehicle, near = np.zeros(6, np.int64), np.zeros(6, np.int64), np.zeros(3 * len(scene.lanes), np.int64)
    cap = COMPILED(
        np.array(scene.rows),
        np.array(scene.lanes),
        scene.target_speed,
        scene.lane,
        scene.previous,
        SIGHT_M,
        near,
        reasons,
        vehicle,
        PRESETS[preset],
    )
    driving = capped(scene.rows, scene.lanes, scene.target_speed, scene.lane, scene.previous, PRESETS[preset])
    assert (reasons.tolist(), vehicle.tolist(), pytest.approx(cap)) == driving
