"""The Gymnasium environment: what the checkers ask for, what seeds give, and what is refused by name."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import fastslow
from deploy.environments.config import OF_VEHICLES
from deploy.environments.single import DrivingEnv
from deploy.environments.vector import DrivingVectorEnv
from deploy.lab.training import scenes_of
from schemas.driving.features import CAP, LEFT_OPEN
from schemas.wire.messages import MetaAction
from sim_node.scenarios import SCENARIOS

HIGHWAY, MERGE, TWO_WAY = (f"fastslow/{name}-v0" for name in ("Highway", "Merge", "TwoWay"))
KINEMATICS = {"type": "Kinematics", "vehicles_count": 7, "features": ["presence", "x", "y", "vx", "vy", "cos_h"]}
GRID = {"type": "OccupancyGrid", "grid_size": [[-30, 30], [-10, 10]], "features": ["presence", "vx"]}


def driven(env: Any, seed: int | None, actions: list[int]) -> list[Any]:
    """All that is seen, earned and said, until the episode ends."""
    observation, info = env.reset(seed=seed)
    out = [observation, info]
    for action in actions:
        *step, info = env.step(action)
        out += [*step, info]
        if step[2] or step[3]:
            break
    return out


def test_every_road_has_an_environment_that_is_found_by_its_id() -> None:
    assert set(fastslow.ENVIRONMENTS.values()) == set(SCENARIOS)
    assert {HIGHWAY, MERGE, TWO_WAY, "fastslow/StockHighway-v0", "fastslow/MergeNatural-v0"} <= set(gymnasium.registry)
    env: Any = gymnasium.make("fastslow:fastslow/Exit-v0").unwrapped
    assert env.scenario.name == "exit"


def test_in_a_folder_with_a_deploy_of_its_own_the_error_names_the_way_out(tmp_path: Path) -> None:
    (tmp_path / "deploy").mkdir()
    (tmp_path / "deploy" / "__init__.py").write_text("")
    root = str(Path(fastslow.__file__).parent)
    start = ("-S", "-c", f"import sys; sys.path.append({root!r}); import fastslow")  # an editable install finds ours
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    ended = subprocess.run([sys.executable, *start], cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    assert "Start Python with -P, or elsewhere" in ended.stderr


@pytest.mark.parametrize("name", fastslow.ENVIRONMENTS)
def test_every_environment_passes_gymnasiums_own_check_without_a_warning(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(name).unwrapped, skip_render_check=True)


def test_stable_baselines3s_own_check_passes_without_a_warning() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(DrivingEnv("merge", duration_s=2.0, observation={"type": "Features", "flat": True}))


@pytest.mark.parametrize("config", [{"observation": KINEMATICS}, {"observation": GRID}, {"mask": None}])
def test_every_kind_of_observation_passes_it_and_lies_in_its_space(config: dict[str, Any]) -> None:
    env = gymnasium.make(HIGHWAY, config=config).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)
    for thing in driven(env, 3, [2, 3, 4, 0, 1] * 6):
        if isinstance(thing, np.ndarray):
            assert thing in env.observation_space


def test_flat_features_are_the_same_in_one_row() -> None:
    flat = {"type": "Features", "flat": True}
    seen, row = (DrivingEnv("merge", **more).reset(seed=1)[0] for more in ({}, {"observation": flat}))  # type: ignore[arg-type]
    np.testing.assert_array_equal(seen.reshape(-1), row)
    rows, _ = DrivingVectorEnv(2, "merge", observation=flat).reset(seed=1)
    np.testing.assert_array_equal(rows[0], row)


def test_the_observations_are_highway_envs_own() -> None:
    shapes = [DrivingEnv(observation=kind).observation_space.shape for kind in (KINEMATICS, GRID)]
    assert shapes == [(7, 6), (2, 12, 4)]


def test_the_environment_is_the_world_that_training_learns_in() -> None:
    env, scenes = DrivingEnv("merge"), scenes_of(SCENARIOS["merge"], 1, 0, 0)
    env.reset(seed=4)
    scenes.world.load(0, SCENARIOS["merge"].spawn(np.random.default_rng(np.random.SeedSequence(4).spawn(3)[0])))  # type: ignore[attr-defined]
    ones = np.ones(1, np.bool_)
    scenes._tracks.forget(ones)
    scenes.told_lane[:], scenes.pass_id[:], scenes.v_des[:], scenes.headway[:] = -1, -1, 15.0, 1.5
    scenes.look()
    env.direct(speed_mps=15.0)
    for action in [1, 2, 3, 1, 0, 3, 1, 1, 4, 2] * 3:
        np.testing.assert_array_equal(env._observed(), scenes.observe()[0])
        np.testing.assert_array_equal(env.action_masks(), scenes.open()[0])
        _, earned, terminated, truncated, _ = env.step(action)
        assert [earned, terminated, truncated] == [v[0] for v in scenes.decide(np.array([action]), redirect=False)]
        if terminated or truncated:
            break


@pytest.mark.parametrize("mask", ["sim", None])
def test_a_picture_changes_nothing(mask: str | None) -> None:
    shown, unseen = DrivingEnv("merge", mask=mask, render_mode="rgb_array"), DrivingEnv("merge", mask=mask)
    actions = [2, 3, 1, 0, 4, 1] * 8
    np.testing.assert_equal(driven(shown, 2, actions), driven(unseen, 2, actions))


@pytest.mark.parametrize("again", [pickle.loads, None], ids=["pickle", "copy"])
def test_a_copy_in_the_middle_of_an_episode_goes_on_as_the_original_does(again: Any) -> None:
    env = DrivingEnv("two-way", noise_m=0.5, dropout=0.1, duration_s=4.0)
    driven(env, 1, [1, 2, 1])
    other = again(pickle.dumps(env)) if again else copy.deepcopy(env)
    rest = [2, 1, 3, 1, 1, 1, 1, 1, 1, 1]
    np.testing.assert_equal([env.step(a) for a in rest[:4]], [other.step(a) for a in rest[:4]])
    np.testing.assert_equal(driven(env, None, rest), driven(other, None, rest))


def test_a_seed_gives_the_same_episode_and_the_ones_after_it_and_another_seed_gives_others() -> None:
    one, same, other = (DrivingEnv("highway", duration_s=3.0) for _ in range(3))
    actions = [2, 3, 1, 0, 4, 1, 2, 1, 1]
    for seed in (5, None, None):
        np.testing.assert_equal(driven(one, seed, actions), driven(same, seed, actions))
    assert not np.array_equal(driven(one, 5, [1])[0], driven(other, 6, [1])[0])


def test_the_action_mask_is_what_samplers_and_maskable_ppo_take() -> None:
    env = gymnasium.make(HIGHWAY)
    _, info = env.reset(seed=0)
    closed = False
    for _ in range(40):
        mask = info["action_mask"]
        assert (mask.dtype, mask.shape) == (np.int8, (5,))
        assert env.get_wrapper_attr("action_masks")().tolist() == mask.astype(bool).tolist()
        action = env.action_space.sample(mask=mask)
        assert mask[action]
        closed |= not mask.all()
        _, _, terminated, truncated, info = env.step(action)
        assert not terminated  # behind the mask
        if truncated:
            break
    assert closed


def test_without_the_mask_everything_that_does_something_is_open_and_collisions_happen() -> None:
    env = DrivingEnv("highway", mask=None)
    assert any(driven(env, seed, [MetaAction.SPEED_UP] * 100)[-1]["crashed"] for seed in range(3))
    observation, info = env.reset(seed=0)
    assert observation[0, CAP] == 4.0  # no cap
    assert observation[0, LEFT_OPEN] == 1.0
    assert info["action_mask"][MetaAction.CRUISE] == 1


def test_a_directive_is_set_for_good_for_an_episode_or_from_now_on() -> None:
    env = DrivingEnv("highway", directive={"lane": 2, "speed_mps": 20.0})
    assert env.reset(seed=0)[1]["intent"] == {"lane": 2, "speed_mps": 20.0, "headway_s": 1.5}
    _, info = env.reset(seed=0, options={"directive": {"lane": 0, "headway_s": 2.0}})
    assert info["intent"] == {"lane": 0, "speed_mps": 28.0, "headway_s": 2.0}
    env.direct(lane=1)
    assert env.step(1)[-1]["intent"]["lane"] == 1
    assert env.reset()[1]["intent"]["lane"] == 2


def test_lanes_density_and_traffic_are_those_asked_for() -> None:
    env = DrivingEnv(
        "highway", config={"lanes_count": 6, "vehicles_density": 1.5, "traffic": ["trucks"]}, render_mode="rgb_array"
    )
    env.reset(seed=0)
    assert env._road is not None
    lanes = {env._road.env.lane_at(*v.position) for v in env._road.env.road.vehicles}
    assert len(env.scenario.lanes) == 6
    assert lanes == set(range(6))
    assert any(v.LENGTH > 6.0 for v in env._road.env.road.vehicles)
    assert DrivingEnv("highway", lanes=1).reset(seed=0)[1]["action_mask"].tolist()[3:] == [0, 0]


def test_the_weights_of_the_reward_are_those_asked_for() -> None:
    usual, other = DrivingEnv("highway"), DrivingEnv("highway", reward={"scale": 1.0})
    assert driven(other, 1, [1])[3] == pytest.approx(10 * driven(usual, 1, [1])[3], rel=1e-6)
    crashing = DrivingEnv("highway", mask=None, reward={"scale": 1.0, "crash": -1000.0})
    worst = min(driven(crashing, seed, [2] * 100)[-4] for seed in range(3))
    assert worst < -900


def test_an_episode_is_as_long_as_asked_for() -> None:
    out = driven(DrivingEnv("highway", duration_s=2.0, decision_hz=5), 0, [1] * 20)
    assert (out[-2], out[-1]["ending"], len(out)) == (True, 4, 2 + 5 * 10)


@pytest.mark.parametrize("action", [7, -1, 2.5, 1.0, np.array([1]), "left", None])
def test_what_is_no_action_is_refused_with_those_that_there_are(action: Any) -> None:
    env = DrivingEnv("merge")
    env.reset(seed=0)
    with pytest.raises(ValueError, match="is not one of: 0 slow down, 1 cruise"):
        env.step(action)


def test_a_step_needs_an_episode() -> None:
    env = DrivingEnv("merge", duration_s=1.0)
    with pytest.raises(ResetNeeded):
        env.step(1)
    driven(env, 0, [1] * 3)
    with pytest.raises(ResetNeeded):
        env.step(1)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"nonsense": 1}, "no setting nonsense: choose from lanes, density"),
        ({"densty": 2.0}, "such as 'density'"),
        ({"density": 9.0}, "density 9"),
        ({"density": "x"}, "Expected 'float', got 'str' - at 'density'"),
        ({"lanes_count": 99}, "lanes 99 is not within 1..8"),
        ({"lanes": 3, "lanes_count": 3}, "lanes_count is told twice"),
        ({"traffic": ["tanks"]}, "traffic tanks: choose from"),
        (
            {"observation": {"type": "LidarObservation"}},
            "'LidarObservation' - at 'observation.type': {'type': 'Features'}",
        ),
        ({"observation": {"type": "Kinematics", "cars": 3}}, "unknown field 'cars'"),
        ({"action": {"type": "ContinuousAction"}}, "no continuous actions"),
        ({"reward": {"crsh": 1}}, "no setting reward.crsh, such as 'crash'"),
        ({"directive": {"lane": 4}}, "lane 4 is not one of 0..3"),
        ({"directive": {"lan": 4}}, "unknown field 'lan'"),
        ({"decision_hz": 4}, "does not divide 15"),
        ({"mask": "none"}, "mask 'none' is not one of: sim, cautious; or None"),
        ({"noise_m": 1.0, "observation": {"type": "Kinematics"}}, "are of the Features"),
        ({"reward": {"crash": float("nan")}}, "reward.crash nan is not a finite number"),
        ({"reward": {"lane": float("inf")}}, "reward.lane inf is not a finite number"),
    ],
)
def test_what_is_no_setting_is_refused_by_name(said: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError) as refused:  # noqa: PT011
        DrivingEnv("highway", config=said)
    assert why in str(refused.value)


@pytest.mark.parametrize(
    ("kind", "options", "why"),
    [
        ("Kinematics", {"features": ["zz"]}, "no setting features.zz: choose from presence, x"),
        ("Kinematics", {"features": ["on_road"]}, "no setting features.on_road"),
        ("Kinematics", {"features": []}, "features are none: choose from presence, x"),
        ("Kinematics", {"vehicles_count": 1}, "vehicles_count 1 is not within 2..1000"),
        ("Kinematics", {"vehicles_count": -3}, "vehicles_count -3 is not within"),
        ("Kinematics", {"vehicles_count": 10**9}, "vehicles_count 1000000000 is not within"),
        ("Kinematics", {"features_range": {"speed": [0, 1]}}, "no setting features_range.speed"),
        ("Kinematics", {"features_range": {"x": [0, 0]}}, "features_range.x 0.0..0.0 is not a finite range"),
        ("OccupancyGrid", {"features": ["zz"]}, "no setting features.zz"),
        ("OccupancyGrid", {"features_range": {"vx": [0, float("nan")]}}, "features_range.vx 0.0..nan is not"),
        ("OccupancyGrid", {"grid_step": [0, 5]}, "grid_step (0.0, 5.0) is not two positive numbers"),
        ("OccupancyGrid", {"grid_size": [[30, -30], [-10, 10]]}, "grid_size 30.0..-30.0 has no number of cells"),
        ("OccupancyGrid", {"grid_size": [[0, 9e9], [-10, 10]]}, "grid_size 0.0..9000000000.0 has no number of cells"),
        ("OccupancyGrid", {"grid_size": [[0, 9000], [0, 9000]]}, "take at most 1000000"),
        ("OccupancyGrid", {"absolute": True}, "absolute True is not in highway-env's own OccupancyGrid"),
    ],
)
def test_what_highway_envs_observations_cannot_do_is_refused_by_name(
    kind: str, options: dict[str, Any], why: str
) -> None:
    with pytest.raises(ValueError) as refused:  # noqa: PT011
        DrivingEnv("highway", observation={"type": kind, **options})
    assert why in str(refused.value)


@pytest.mark.parametrize("road", ["highway", "roadworks"])
def test_every_feature_that_highway_env_has_may_be_seen_and_lies_in_the_space_beside_an_obstacle_too(road: str) -> None:
    kind = {"type": "Kinematics", "features": OF_VEHICLES, "vehicles_count": 30, "see_behind": True}
    env = DrivingEnv(road, observation=kind)
    env.reset(seed=0)
    assert env._road is not None
    assert env._road.env.ego.to_dict().keys() == set(OF_VEHICLES)
    for thing in driven(env, 0, [*[int(MetaAction.SPEED_UP)] * 4, *[int(MetaAction.CRUISE)] * 50]):
        if isinstance(thing, np.ndarray):
            assert thing in env.observation_space


def test_a_grid_as_an_image_is_the_grid_in_bytes() -> None:
    env, plain = (DrivingEnv("highway", observation={**GRID, "as_image": image}) for image in (True, False))
    (image, _), (grid, _) = (e.reset(seed=0) for e in (env, plain))
    assert image in env.observation_space
    assert set(np.unique(image[0])) == {127, 255}  # nobody, somebody
    np.testing.assert_array_equal(image, ((grid + 1) * 127.5).astype(np.uint8))


def test_the_largest_seed_has_an_episode_and_a_larger_one_is_refused_by_name() -> None:
    for options in ({}, {"observation": KINEMATICS}):
        env = DrivingEnv("highway", config=options)
        env.reset(seed=2**63 - 1)
        with pytest.raises(ValueError, match="seed 9223372036854775808 is above 9223372036854775807"):
            env.reset(seed=2**63)


@pytest.mark.parametrize("scenario", ["merge", "two-way", "highway-v0"])
def test_a_road_of_its_own_shape_keeps_its_lanes(scenario: str) -> None:
    with pytest.raises(ValueError, match="has the lanes that it has"):
        DrivingEnv(scenario, lanes=3)


@pytest.mark.parametrize("options", [{"config": {}}, {"directive": {"lane": 9}}, {"directive": {"lane": "left"}}])
def test_options_that_mean_nothing_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"no option 'config'|lane 9|Expected 'int"):
        DrivingEnv("highway").reset(seed=0, options=options)


def test_it_renders_a_picture_per_decision_at_the_speed_of_the_drive() -> None:
    env = gymnasium.make(MERGE, render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (360, 960, 3)  # type: ignore[union-attr]
    assert env.metadata["render_fps"] == 3
