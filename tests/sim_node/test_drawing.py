"""A tick as a picture: what a person must see in it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from schemas.wire.messages import Action, Closure, Lane, MetaAction, Observation, Reason
from sim_node.drawing import AMBER, EGO, ONCOMING, OTHER, RED, SIZE, picture

ROWS = [[0.0, 500.0, 4.0, 8.0, 0.0, 0.0, 5.0, 2.0, 1.0], [7.0, 520.0, 4.0, 6.0, 0.0, 0.0, 5.0, 2.0, 1.0]]
LANES = (
    Lane(y_m=0.0, start_m=0.0, end_m=3000.0, direction=-1, kind="oncoming", speed_limit_mps=8.0),
    Lane(y_m=4.0, start_m=0.0, end_m=3000.0, speed_limit_mps=8.0),
)


def seen(**more: object) -> Observation:
    fields: dict[str, object] = {"tick": 0, "lanes": LANES, "target_lane": 1, "target_speed_mps": 8.0, **more}
    return Observation(epoch=1, stamp_ns=0, scenario="two-way", rows=np.array(ROWS, "<f4").tobytes(), **fields)  # type: ignore[arg-type]


def count(drawn: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int((np.abs(drawn.astype(int) - colour).sum(-1) < 12).sum())


def test_a_picture_shows_the_ego_the_others_and_the_oncoming_lane():
    drawn = picture(seen())
    assert drawn.shape == (SIZE[1], SIZE[0], 3)
    assert drawn.dtype == np.uint8
    assert min(count(drawn, EGO), count(drawn, OTHER), count(drawn, ONCOMING)) > 500


def test_the_picture_is_drawn_without_a_screen(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    assert picture(seen()).max() > 200


def test_a_lane_change_shows_the_turn_signal_and_where_it_leads():
    still, changing = picture(seen()), picture(seen(target_lane=0))
    assert count(changing, AMBER) > count(still, AMBER)
    assert count(changing, EGO) > count(still, EGO)


def test_the_turn_signal_flashes():
    assert count(picture(seen(target_lane=0, tick=0)), AMBER) > count(picture(seen(target_lane=0, tick=5)), AMBER)


def test_braking_shows_the_brake_lights():
    assert count(picture(seen(acceleration_mps2=-3.0)), RED) > count(picture(seen()), RED)


def test_the_vehicle_that_closes_an_action_is_marked():
    action = Action(
        epoch=1, stamp_ns=0, answers_tick=0, meta_action=int(MetaAction.CRUISE), source="policy",
        closed=(Closure(action=int(MetaAction.SPEED_UP), reason=Reason.SPEED_FOR_GAP, vehicle=7),),
    )  # fmt: skip
    by_the_road = Action(
        epoch=1, stamp_ns=0, answers_tick=0, meta_action=int(MetaAction.CRUISE), source="policy",
        closed=(Closure(action=int(MetaAction.SPEED_UP), reason=Reason.LANE_ENDS),),
    )  # fmt: skip
    assert count(picture(seen(), action), RED) > count(picture(seen(), by_the_road), RED) + 100


@pytest.mark.parametrize("ends_m", [505.0, 560.0])
def test_the_end_of_a_lane_is_barred_where_it_is_in_sight(ends_m):
    ramp = (LANES[1], Lane(y_m=8.0, start_m=0.0, end_m=ends_m, kind="ramp", speed_limit_mps=8.0))
    near, far = picture(seen(lanes=ramp, target_lane=0)), picture(seen(lanes=(LANES[1],), target_lane=0))
    assert (count(near, RED) > count(far, RED)) == (ends_m < 540.0)


@pytest.mark.parametrize("decision_hz", [1, 5, 15])
def test_a_video_of_the_environment_runs_at_the_speed_of_the_drive(decision_hz):
    env: Any = gymnasium.make("sim_node:FastSlow-merge-v0", decision_hz=decision_hz, render_mode="rgb_array")
    env.reset(seed=7)
    before = env.render()
    env.step(int(MetaAction.CRUISE))
    assert env.metadata["render_fps"] == decision_hz
    assert before.shape == (SIZE[1], SIZE[0], 3)
    assert (env.render() != before).any()
