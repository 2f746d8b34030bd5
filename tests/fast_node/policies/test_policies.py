"""The policy seam: everything that can drive is found by one function, and drives behind the mask."""

from __future__ import annotations

import gc
import itertools
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from deploy.lab.lockstep import Episode, overtake_at, run_episode
from fast_node.__main__ import nodes_of, warm_up
from fast_node.config import FastConfig
from fast_node.node import FastNode
from fast_node.policies.load import BUILT_IN, files_of, load_policy
from fast_node.policies.mlp import shipped
from fast_node.policies.outsider import DeadlinePolicy
from fast_node.policies.plans import to_enter
from fast_node.policies.policy import NamedPolicy
from fast_node.policies.rule import rule_logits
from schemas.driving.features import FEATURES, N_ROWS, Array
from schemas.runtime.process import ConfigError
from schemas.wire.messages import MetaAction
from sim_node.config import SimConfig
from sim_node.node import SimNode

ROOT = Path(__file__).parents[3]
NUMBERS = itertools.count()
Outsider = Callable[[str], str]

EAGER = """
import numpy as np

class Eager:
    mask_preset = "cautious"

    def logits(self, x):
        return np.broadcast_to(np.float32([0, 1, 4, 3, 2]), (*x.shape[:-2], 5))

def load():
    return Eager()
"""


@pytest.fixture
def outsider(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Outsider:
    """Writes a module into the current folder, a temporary one, and returns the spec of its `load`."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])

    def write(source: str) -> str:
        name = f"outsider_{next(NUMBERS)}"
        (tmp_path / f"{name}.py").write_text(source)
        return f"{name}:load"

    return write


def seen(*batch: int) -> Array:
    """Policy inputs of empty roads."""
    x = np.zeros((*batch, N_ROWS, len(FEATURES)), np.float32)
    x[..., 0, :2] = 1.0
    return x


def drive(policy: NamedPolicy, seconds: float = 20.0) -> Episode:
    return run_episode(1000, policy, overtake_at(3.0), duration_s=seconds)


def test_an_outsiders_policy_drives_the_lock_step_node_behind_the_mask_of_its_preset(outsider: Outsider) -> None:
    spec = outsider(EAGER)
    policy = load_policy(spec)
    run = drive(policy)
    assert (policy.name, policy.mask_preset) == (spec, "cautious")
    assert not run.collided
    assert run.overridden > 0


@pytest.mark.parametrize(
    "logits",
    [
        pytest.param("return np.full((*x.shape[:-2], 5), np.nan)", id="not a number"),
        pytest.param("raise KeyError('lost')", id="raising"),
        pytest.param("raise SystemExit", id="leaving"),
        pytest.param("return np.zeros(4)", id="too short"),
        pytest.param("return None", id="nothing"),
    ],
)
def test_where_an_outsider_fails_while_driving_the_rule_behind_the_mask_drives(outsider: Outsider, logits: str) -> None:
    policy = load_policy(
        outsider(f"""
import numpy as np

class Fails:
    calls = 0

    def logits(self, x):
        self.calls += 1
        if self.calls > 30:
            {logits}
        return np.zeros((*x.shape[:-2], 5))

load = Fails
""")
    )
    sim, node = SimNode(SimConfig(scenario="two-way", seed=1000)), FastNode(FastConfig(), policy)
    sim.reset(1)
    observation, sources = sim.observation(0), []
    for _ in range(300):
        action, _ = node.step(observation, None, 0)
        sources.append(action.source)
        observation = sim.step(action, 0)
    assert set(sources[30:]) == {"fallback"} != set(sources[:10])
    assert sim.metrics.collisions == 0


class Stuck:
    """Answers nothing until it is let go."""

    def __init__(self) -> None:
        self.go, self.asked = threading.Event(), 0

    def logits(self, x: Array) -> Array:
        self.asked += 1
        self.go.wait()
        return np.zeros(5, np.float32)


def test_a_policy_that_is_too_slow_costs_its_tick_and_is_not_asked_again_before_it_has_answered() -> None:
    stuck = Stuck()
    policy = NamedPolicy("stuck", DeadlinePolicy(stuck, 0.001))
    run = drive(policy, seconds=10.0)
    assert (run.collided, run.seconds, stuck.asked) == (False, 10.0, 1)
    stuck.go.set()


def test_a_late_answer_is_dropped_and_the_next_one_in_time_counts() -> None:
    stuck = Stuck()
    policy = DeadlinePolicy(stuck, 0.001)
    with pytest.raises(TimeoutError, match="within 1 ms"):
        policy.logits(seen())
    with pytest.raises(TimeoutError, match="earlier tick"):
        policy.logits(seen())
    stuck.go.set()
    assert policy._last is not None
    policy._last.result()
    patient = DeadlinePolicy(stuck, 60.0)
    assert patient.logits(seen()).tolist() == [0.0] * 5
    assert patient.logits(seen()).tolist() == [0.0] * 5


def test_nobody_rehearses_with_a_policy_that_may_remember(outsider: Outsider) -> None:
    policy = load_policy("random:3")
    again = load_policy("random:3")
    _, rehearser = nodes_of(FastConfig(), policy)
    sim = SimNode(SimConfig())
    sim.reset(1)
    rehearser.step(sim.observation(0), None, 0)
    assert policy.logits(seen()).tolist() == again.logits(seen()).tolist()


def test_before_it_goes_live_the_node_has_driven_without_words_and_has_planned_a_way_into_a_lane() -> None:
    planned: list[bool] = []

    class Watched:
        def logits(self, x: Array) -> Array:
            planned.append(bool(to_enter(x[None])[0]))
            return rule_logits(x)

    _, rehearser = nodes_of(FastConfig(), NamedPolicy("watched", Watched()))
    warm_up(rehearser)
    gc.unfreeze()  # the tests' own objects
    assert planned == [False, False, True, True]
    assert rehearser.counts["fallback"] == 0


def answering(expression: str) -> str:
    """A module whose policy answers with this expression of x."""
    return f"class load:\n    def logits(self, x):\n        return {expression}\n"


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("import no_such_thing", "cannot import .*no_such_thing.*line 1"),
        ("raise SystemExit(3)", "cannot import"),
        ("", "has no callable 'load'"),
        ("load = 5", "has no callable 'load'"),
        ("def load():\n    raise OSError('no weights')", r"load\(\) raised OSError: no weights .*line 2"),
        ("load = dict", r"returned dict, which has no method logits\(x\)"),
        (answering("x[0, 0, 0, 0]"), r"logits\(x\) raised IndexError.*line 3"),
        (answering("[0, 0, 0, 0]"), r"shape \(4,\).*return \(5,\)"),
        (answering("[0, 0, 0, 0, 1]"), r"return \(2, 5\)"),
        (answering("x[..., 0, :5] / 0"), "not finite"),
        (answering("x[..., 0, :5]") + "    mask_preset = 'bold'", "sim, cautious"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_an_outsider_that_cannot_drive_is_refused_in_one_line(outsider: Outsider, source: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as refused:
        load_policy(outsider(source))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("spec", ["nobody", "", "rule:", "rule:1", "constant", ":load", "mine:"])
def test_an_unknown_name_is_refused_with_those_that_there_are(spec: str) -> None:
    with pytest.raises(ConfigError, match=r"cruise|fastslow, network, courses"):
        load_policy(spec)


@pytest.mark.parametrize("spec", ["constant:", "constant:up", "constant:left,left", "random:x", "random:-1"])
def test_a_name_with_the_wrong_more_is_refused_with_what_it_takes(spec: str) -> None:
    with pytest.raises(ConfigError, match=r"cruise, slower, faster, left, right|random:0"):
        load_policy(spec)


def test_a_constant_policy_prefers_the_named_actions_in_their_order_and_then_the_mildest() -> None:
    order = load_policy("constant:left,faster").logits(seen(3))
    assert np.argsort(-order, axis=-1).tolist() == [
        [MetaAction.LEFT, MetaAction.SPEED_UP, MetaAction.CRUISE, MetaAction.SLOW_DOWN, MetaAction.RIGHT]
    ] * 3  # fmt: skip


def test_a_random_policy_draws_each_time_and_follows_its_seed() -> None:
    def wanted(spec: str) -> list[list[float]]:
        policy = load_policy(spec)
        return [policy.logits(seen()).tolist() for _ in range(31)]

    once, again, other = wanted("random:7"), wanted("random:7"), wanted("random:8")
    assert once == again != other
    assert len({tuple(row) for row in once}) == 31
    assert {int(np.argmax(row)) for row in once} == set(range(5))


@pytest.mark.parametrize("spec", [name for name in BUILT_IN if name != "constant"] + ["constant:faster,left"])
def test_every_built_in_policy_drives_the_node_and_never_into_anybody(spec: str) -> None:
    run = drive(load_policy(spec), seconds=10.0)
    assert not run.collided
    assert run.seconds == 10.0


@pytest.mark.parametrize("spec", [name for name in BUILT_IN if name not in ("constant", "random")])
def test_one_input_and_a_batch_of_it_get_the_same_preferences(spec: str) -> None:
    x, policy = seen(), load_policy(spec)
    assert np.allclose(policy.logits(np.stack([x, x])), policy.logits(x), atol=1e-4)


def test_a_checkpoints_path_drives_whatever_learnt_it() -> None:
    by_path, by_name = load_policy(str(shipped("dqn", "masked"))), load_policy("dqn-masked")
    assert np.array_equal(by_path.logits(seen(2)), by_name.logits(seen(2)))
    assert by_path.sidecar["algorithm"] == "dqn"


def test_no_policy_of_ours_imports_torch() -> None:
    asked = (
        "import sys, fast_node.__main__ as main\n"
        "from fast_node.policies.load import BUILT_IN, files_of, load_policy\n"
        "for name in BUILT_IN: load_policy(name + (':left' if name == 'constant' else ''))\n"
        "assert 'torch' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", asked], cwd=ROOT, timeout=120).returncode == 0


def test_every_file_that_a_policy_is_read_from_is_known(tmp_path: Path) -> None:
    weights = tmp_path / "courses.json"
    assert [file.name for file in files_of()] == ["fastslow.safetensors", "courses.json", "gaps.json"]
    assert files_of(f"courses:{weights}")[1] == weights
    assert [file.name for file in files_of("ppo-masked")] == ["ppo-masked.safetensors"]
    assert files_of("rule") == files_of("random:1") == files_of("mine:factory") == ()
    assert files_of("runs/mine.safetensors") == (Path("runs/mine.safetensors"),)
