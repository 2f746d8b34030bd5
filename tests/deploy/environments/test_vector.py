"""The vector environment is as many single ones, whatever the autoreset mode, and is made by `make_vec`."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import fastslow
from deploy.environments.vector import DrivingVectorEnv

N = 3
TWO_WAY = next(name for name, scenario in fastslow.ENVIRONMENTS.items() if scenario == "two-way")
MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)


def same(one: Any, other: Any) -> None:
    """The same values of the same types."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            same(one[name], other[name])
    else:
        assert one.dtype == other.dtype
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "settings", [{}, {"mask": None}, {"noise_m": 0.5, "dropout": 0.1, "directive": {"overtake": True}}]
)
def test_it_is_gymnasiums_vector_of_single_environments_to_the_bit(
    mode: AutoresetMode, settings: dict[str, Any]
) -> None:
    settings = {"duration_s": 5.0, **settings}
    ours = gymnasium.make_vec(TWO_WAY, num_envs=N, autoreset_mode=mode, **settings)
    theirs = gymnasium.make_vec(
        TWO_WAY, num_envs=N, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **settings
    )
    assert isinstance(ours, DrivingVectorEnv)
    assert isinstance(theirs, SyncVectorEnv)
    assert ours.metadata["autoreset_mode"] == mode
    assert (ours.observation_space, ours.action_space) == (theirs.observation_space, theirs.action_space)
    for a, b in zip(ours.reset(seed=5), theirs.reset(seed=5), strict=True):
        same(a, b)
    rng, ends = np.random.default_rng(0), 0
    for k in range(40):
        actions = rng.integers(0, 5, N) if k % 2 else np.ones(N, np.int64)
        ahead, behind = ours.step(actions), theirs.step(actions)
        for a, b in zip(ahead, behind, strict=True):
            same(a, b)
        assert ahead[0] in ours.observation_space
        ends += int((ahead[2] | ahead[3]).sum())
    assert ends > N


def test_with_autoreset_disabled_scenes_are_reset_by_mask_and_a_forgotten_one_is_named() -> None:
    env = DrivingVectorEnv(N, "two-way", autoreset_mode="Disabled", duration_s=1.0)
    with pytest.raises(ValueError, match="scene 0 has no episode"):
        env.step(np.ones(N, np.int64))
    env.reset(seed=[1, 2, 3])
    for _ in range(3):
        *_, truncated, _ = env.step(np.ones(N, np.int64))
    assert truncated.all()
    with pytest.raises(ValueError, match="scene 0 has no episode"):
        env.step(np.ones(N, np.int64))
    fresh, infos = env.reset(seed=[7, None, None], options={"reset_mask": np.array([True, False, False])})
    assert infos["_speed"].tolist() == [True, False, False]
    np.testing.assert_array_equal(fresh[0], DrivingVectorEnv(1, "two-way", duration_s=1.0).reset(seed=7)[0][0])


def test_its_masks_are_those_of_the_sampler_and_of_maskable_ppo() -> None:
    env = DrivingVectorEnv(N, "highway")
    _, infos = env.reset(seed=0)
    assert (infos["action_mask"].dtype, infos["action_mask"].shape) == (np.int8, (N, 5))
    np.testing.assert_array_equal(env.action_masks(), infos["action_mask"] == 1)
    actions = env.action_space.sample(mask=tuple(infos["action_mask"]))
    assert infos["action_mask"][np.arange(N), actions].all()


@pytest.mark.parametrize("actions", [np.array([0, 1, 5]), np.array([0, 1]), np.array([0.0, 1.0, 2.0]), [0, 1, -1]])
def test_what_are_no_actions_is_refused(actions: Any) -> None:
    env = DrivingVectorEnv(N, "highway")
    env.reset(seed=0)
    with pytest.raises(ValueError, match="are not 3 whole numbers out of: 0 slow down"):
        env.step(actions)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"observation": {"type": "Kinematics"}}, "vectorization_mode='sync'"),
        ({"render_mode": "rgb_array"}, "not rendered"),
        ({"nonsense": 1}, "no setting nonsense"),
        ({"num_envs": 0}, "num_envs 0"),
    ],
)
def test_what_many_roads_cannot_do_is_refused_by_name(said: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        gymnasium.make_vec(TWO_WAY, **said)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"config": {}}, "no option 'config'"),
        ({"reset_mask": np.array([True])}, "not an array of 3 booleans"),
        ({"directive": {"lane": 7}}, "lane 7 is not one of 0..3"),
    ],
)
def test_options_that_mean_nothing_are_refused(options: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        DrivingVectorEnv(N, "highway").reset(seed=0, options=options)


@pytest.mark.parametrize("mode", MODES)
def test_a_copy_goes_on_as_the_original_does(mode: AutoresetMode) -> None:
    env = DrivingVectorEnv(N, "two-way", duration_s=3.0, autoreset_mode=mode)
    env.reset(seed=1)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(4):
        env.step(rng.integers(0, 5, N))
    copies = [pickle.loads(pickle.dumps(env)), copy.deepcopy(env)]
    for _ in range(20):  # into the next episodes, whose seeds the copies draw alike
        actions = rng.integers(0, 5, N)
        step = env.step(actions)
        for other in copies:
            for ours, theirs in zip(step, other.step(actions), strict=True):
                same(ours, theirs)
        ends += int((step[2] | step[3]).sum())
    assert ends > N


def test_gymnasiums_wrappers_tell_an_episodes_length() -> None:
    env: Any = DrivingVectorEnv(N, "merge", duration_s=2.0)
    wrapped = RecordEpisodeStatistics(env)
    wrapped.reset(seed=1)
    for _ in range(12):
        *_, infos = wrapped.step(np.ones(N, np.int64))
        if "episode" in infos:
            break
    assert infos["episode"]["l"].max() == 6


@pytest.mark.parametrize("seed", [2**63 - N + 1, np.int64(2**63 - 1), [0, 2**63, 1]])
def test_seeds_that_do_not_fit_are_refused_by_name_and_the_largest_does(seed: Any) -> None:
    env = DrivingVectorEnv(N, "highway")
    env.reset(seed=2**63 - N)
    with pytest.raises(ValueError, match=r"seed 92233720368547758\d\d is above 92233720368547758"):
        env.reset(seed=seed)
