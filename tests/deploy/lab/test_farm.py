"""Work that is spread gives what it gives at home, whoever is lost on the way; what is kept is not driven twice."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from deploy.lab import rows
from deploy.lab.evaluate import evaluate_all
from deploy.lab.farm import Farm, _as_here, code_digest
from deploy.lab.learning import Training, run_on
from deploy.lab.rows import Cell, Kept
from deploy.lab.study import cells as study_cells
from deploy.lab.study.matrix import run_cells
from schemas.runtime.process import ConfigError
from sim_node.scenarios import SCENARIOS

AGENTS, EPISODES = ("rule", "faster"), 3
CELL = Cell(
    agent="faster",
    is_policy=False,
    scenario=SCENARIOS["two-way"],
    seeds=range(1000, 1003),
    wish_mps=None,
    directive="hurry",
    checkpoint=None,
    conditions={"noise_m": 0.0},
)


def square(number: int) -> int:
    if number < 0:
        raise ConfigError("no negative numbers")
    return number**2


def evaluated(**more: Any) -> dict[str, Any]:
    return evaluate_all(AGENTS, ["two-way"], EPISODES, **more)


@pytest.mark.parametrize("farm", [Farm(), Farm(jobs=2)], ids=["here", "in processes"])
def test_every_task_is_done_and_knows_its_place(farm: Farm) -> None:
    assert sorted(farm.run(square, [(n,) for n in range(5)])) == [(n, n**2) for n in range(5)]


@pytest.mark.parametrize("farm", [Farm(), Farm(jobs=2)], ids=["here", "in processes"])
def test_what_a_task_raises_is_raised(farm: Farm) -> None:
    with pytest.raises(ConfigError, match="negative"):
        list(farm.run(square, [(1,), (-1,)]))


def test_rows_that_are_driven_in_processes_are_the_same_to_the_digit() -> None:
    assert evaluated(farm=Farm(jobs=2)) == evaluated()


def test_rows_that_are_kept_are_the_same_to_the_digit_and_not_driven_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = evaluated(kept=Kept(tmp_path / "kept.jsonl"))
    monkeypatch.setattr(rows, "drive_cell", None)
    assert evaluated(kept=Kept(tmp_path / "kept.jsonl")) == first


def test_a_row_that_was_cut_off_while_it_was_written_is_driven_again_and_the_others_are_not(tmp_path: Path) -> None:
    path = tmp_path / "kept.jsonl"
    evaluated(kept=Kept(path))
    whole = path.read_bytes()
    path.write_bytes(whole[:-40])
    told: list[str] = []
    evaluated(kept=Kept(path), progress=told.append)
    assert told[0] == "1 of 2 rows were driven before"
    assert path.read_bytes() == whole


@pytest.mark.parametrize(
    "other",
    [
        {"seeds": range(1000, 1004)},
        {"wish_mps": 20.0},
        {"conditions": {"noise_m": 0.1}},
        {"scenario": SCENARIOS["two-way"].varied((), 2.0)},
    ],
)
def test_a_row_of_other_conditions_does_not_count(other: dict[str, Any], tmp_path: Path) -> None:
    kept = Kept(tmp_path / "kept.jsonl")
    kept.add(CELL, ([], {}))
    again = Kept(tmp_path / "kept.jsonl")
    assert again.of(CELL) == ([], {})
    assert again.of(replace(CELL, **other)) is None


def test_a_row_of_another_state_of_the_code_does_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Kept(tmp_path / "kept.jsonl").add(CELL, ([], {}))
    monkeypatch.setattr(rows, "code_digest", lambda: "another")
    assert Kept(tmp_path / "kept.jsonl").of(CELL) is None


@pytest.mark.parametrize("text", ["buy milk\n", "buy milk", '{"algorithm": "ours"}', "a,b\n1,2\n3,4", '{"cell": 1}\n'])
def test_a_file_that_holds_something_else_is_refused_and_left_alone(text: str, tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text(text)
    with pytest.raises(ConfigError, match="name another file"):
        Kept(path)
    assert path.read_text() == text


@pytest.mark.parametrize("other", [{"agent": "mine:load", "is_policy": True}, {"agent": "dilu-paused"}])
def test_what_somebody_elses_code_or_a_language_model_has_driven_is_not_kept(
    other: dict[str, Any], tmp_path: Path
) -> None:
    kept = Kept(tmp_path / "kept.jsonl")
    kept.add(replace(CELL, **other), ([], {}))
    assert not (tmp_path / "kept.jsonl").exists()


def test_a_row_of_a_checkpoint_that_has_changed_does_not_count(tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    path.write_bytes(b"1")
    cell = replace(CELL, agent=str(path), is_policy=True)
    Kept(tmp_path / "kept.jsonl").add(cell, ([], {}))
    assert Kept(tmp_path / "kept.jsonl").of(cell) == ([], {})
    path.write_bytes(b"2")
    assert Kept(tmp_path / "kept.jsonl").of(cell) is None


def die(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_process_that_is_killed_ends_the_work_with_one_line() -> None:
    with pytest.raises(ConfigError, match="fewer --jobs"):
        list(Farm(jobs=1).run(die, [(1,)]))


def test_a_machine_with_other_code_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="install the same"):
        _as_here("another", ".", square, 2)
    assert _as_here(code_digest(), ".", square, 2) == 4


def test_a_cell_that_is_run_elsewhere_brings_all_its_files_home(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    (cell,) = study_cells.cells_of(["ours"], ["two-way"], [0], 1024, 2)
    run_cells([cell], tmp_path / "away", Farm())
    (tmp_path / "home").mkdir()
    study_cells.run_cell(cell, tmp_path / "home")
    away, home = ({p.name for p in (tmp_path / name).iterdir()} for name in ("away", "home"))
    assert away == home
    assert study_cells.finished(cell, tmp_path / "away")


def test_a_training_that_is_run_elsewhere_brings_the_policy_home_that_it_would_be_here(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    training = Training(algorithm="ours", scenarios=("two-way",), steps=1024, seed=3)
    here, away = tmp_path / "here" / "p.safetensors", tmp_path / "away" / "p.safetensors"
    here.parent.mkdir()
    assert run_on(Farm(), training, away).keys() == training.run(here).keys()
    assert away.read_bytes() == here.read_bytes()
    assert {p.name for p in away.parent.iterdir()} == {p.name for p in here.parent.iterdir()}


# With Ray


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A node on loopback, with room for one task."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")  # loopback is good enough; read where Ray is imported
        pytest.importorskip("ray")
        from ray.cluster_utils import Cluster

        node = {"num_cpus": 1, "node_ip_address": "127.0.0.1", "include_dashboard": False}
        cluster = Cluster(initialize_head=True, head_node_args=node)
        try:
            yield cluster
        finally:
            cluster.shutdown()


@pytest.fixture
def two_nodes(cluster: Any) -> Iterator[Any]:
    """The cluster with a second node like the first; this process has joined it."""
    import ray

    if not cluster.worker_nodes:
        cluster.add_node(num_cpus=1, node_ip_address="127.0.0.1")
    try:
        ray.init(address=cluster.address, log_to_driver=False)
        yield cluster
    finally:
        ray.shutdown()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_rows_on_a_cluster_that_loses_a_node_are_the_same_to_the_digit(two_nodes: Any, tmp_path: Path) -> None:
    here, told = evaluated(), []

    def progress(text: str) -> None:
        told.append(text)
        if len(told) == 1:
            two_nodes.remove_node(two_nodes.worker_nodes.copy().pop(), allow_graceful=False)

    assert evaluated(farm=Farm(ray=two_nodes.address), progress=progress) == here


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_study_on_a_cluster_is_the_study_at_home_with_its_policies(two_nodes: Any, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    todo = study_cells.cells_of(["ours"], ["two-way"], [0, 1], 1024, 2)
    away, home = (
        run_cells(todo, tmp_path / name, farm)
        for name, farm in (("away", Farm(ray=two_nodes.address)), ("home", Farm()))
    )
    for result in away + home:
        del result["cpu_s"]
    assert away == home
    for cell in todo:
        weights = [(tmp_path / name / f"{cell.name}.safetensors").read_bytes() for name in ("away", "home")]
        assert weights[0] == weights[1]


def test_a_cluster_that_is_not_there_is_a_configuration_error() -> None:
    pytest.importorskip("ray")
    with pytest.raises(ConfigError, match="--ray local"):
        list(Farm(ray="127.0.0.1:1").run(square, [(1,)]))
