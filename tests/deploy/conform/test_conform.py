"""`fastslow conform` with real processes: the protocol page's own examples, and copies of them that are broken."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import schemas
from schemas.runtime.process import CONFIG, UNAVAILABLE
from tests.running import ROOT

PAGE = (Path(schemas.__file__).parent / "README.md").read_text()
DRIVER, SIMULATOR = re.findall(r"```python\n(.*?)```", PAGE, re.S)
CLIENT = '{"bus": {"mode": "client", "connect": ["tcp/127.0.0.1:{port}"]}}'
EXAMPLES = {"--sim": SIMULATOR, "--driver": DRIVER}
OURS = [("--sim", "sim_node"), ("--driver", "fast_node")]
BROKEN: dict[str, tuple[dict[str, str], dict[str, str]]] = {
    # What is put for what in the page's simulator; and which duties do not hold any more, with a word of the reason.
    "stamps, ids, worlds, answers": (
        {
            "time.monotonic_ns()}": "time.time_ns()}",
            "cars = [(0,": "cars = [(7,",
            'kind="world"': 'kind="fault"',
            "applied = tick if action else applied": "applied = -1",
        },
        {"stamps": "ahead of CLOCK_MONOTONIC", "ids": "which is 0", "epochs": "no event", "answers": "applied_tick"},
    ),
    "units, budget, silence, strays": (
        {
            "cars = [(0, x, y, v,": "cars = [(0, x, y, 3.6 * v,",
            "BUDGET_S, LENGTH_M = 15, 0.02": "BUDGET_S, LENGTH_M = 15, 0.05",
            "if silent > 2": "if silent > 999",
            'action["answers_tick"]) == (epoch, tick)': "tick) == (epoch, tick)",
        },
        {"units": "m/s and m", "budget": "was applied", "silence": "does not brake", "strays": "was carried out"},
    ),
    "rate, robustness": (
        {
            "HZ, BUDGET_S, LENGTH_M = 15,": "HZ, BUDGET_S, LENGTH_M = 10,",
            "        except Exception:": "        except KeyError:",
        },
        {"rate": "hz says 10", "keeps going": "in the phase 'strays'"},
    ),
}
BROKEN_DRIVERS: dict[str, tuple[dict[str, str], dict[str, str]]] = {
    "ticks and versions": (
        {
            '"answers_tick": seen["tick"]': '"answers_tick": seen["tick"] + 1',
            '.split(".")[0] == "3"': '.split(".")[0] != "2"',
        },
        {"each tick": "answers_tick", "other major": "refuse another major"},
    ),
    "lateness, stamps": (
        {
            "        rows = list(": "        time.sleep(0.04)\n        rows = list(",
            '"stamp_ns": time.monotonic_ns()': '"stamp_ns": time.time_ns()',
        },
        {"late": "came after 20 ms", "stamps": "ahead of CLOCK_MONOTONIC"},
    ),
    "worlds": (
        {'if seen["epoch"] != world:': "if world < 0:", '"epoch": seen["epoch"],': '"epoch": world,'},
        {"epochs": "answers of epoch"},
    ),
    "numbers, robustness": (
        {'"meta_action": meta_action': '"meta_action": 9', "except Exception:": "except KeyError:"},
        {"readable": "meta_action 9", "nonsense": "were answered"},
    ),
}


def conform(*words: str, timeout_s: float = 150.0) -> tuple[int, dict[str, Any], str]:
    """Exit code, what is on stdout as data, and stderr."""
    done = subprocess.run(
        [sys.executable, "-m", "deploy", "conform", "--json", *words],
        capture_output=True,
        text=True,
        timeout=timeout_s,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
    )
    return done.returncode, json.loads(done.stdout or "{}"), done.stderr


def wrong(data: dict[str, Any]) -> dict[str, str]:
    return {duty["name"]: duty["found"] for duty in data["duties"] if not duty["holds"]}


def broken(code: str, changes: dict[str, str], path: Path) -> str:
    for was, now in changes.items():
        assert was in code
        code = code.replace(was, now)
    path.write_text(code)
    return str(path)


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, dict[str, Any], str]]:
    """What is said of the page's examples and of our own nodes, all tried at once: each waits for most of its time."""
    folder = tmp_path_factory.mktemp("examples")
    tried: dict[str, tuple[str, ...]] = {
        module: (role, "--", sys.executable, "-m", module, CLIENT) for role, module in OURS
    }
    for role, code in EXAMPLES.items():
        (script := folder / f"{role.strip('-')}.py").write_text(code)
        tried[role] = (role, "--budget-ms", "20", "--", sys.executable, str(script), "{port}")
    with ThreadPoolExecutor(len(tried)) as pool:
        return dict(zip(tried, pool.map(lambda words: conform(*words), tried.values()), strict=True))


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize("role", EXAMPLES, ids=["simulator", "driver"])
def test_the_page_s_example_keeps_every_duty(role: str, judged: dict[str, tuple[int, dict[str, Any], str]]) -> None:
    code, data, stderr = judged[role]
    assert (code, wrong(data)) == (0, {}), stderr


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize(("role", "module"), OURS)
def test_our_own_node_keeps_every_duty(
    role: str, module: str, judged: dict[str, tuple[int, dict[str, Any], str]]
) -> None:
    code, data, stderr = judged[module]
    assert (code, wrong(data)) == (0, {}), stderr


@pytest.mark.thorough
@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize(
    ("role", "code", "copies"),
    [("--sim", SIMULATOR, BROKEN), ("--driver", DRIVER, BROKEN_DRIVERS)],
    ids=["sim", "driver"],
)
def test_a_broken_copy_of_the_example_is_told_what_is_wrong(
    role: str, code: str, copies: dict[str, tuple[dict[str, str], dict[str, str]]], tmp_path: Path
) -> None:
    def judged(k: int, changes: dict[str, str]) -> tuple[int, dict[str, Any], str]:
        script = broken(code, changes, tmp_path / f"{k}.py")
        return conform(role, "--", sys.executable, script, "{port}")

    with ThreadPoolExecutor() as pool:  # each takes a quarter of a minute of waiting
        found = list(pool.map(lambda item: judged(item[0], item[1][0]), enumerate(copies.values())))
    for (_, expected), (exit_code, data, stderr) in zip(copies.values(), found, strict=True):
        assert exit_code == 1, stderr
        said = wrong(data)
        for duty, word in expected.items():
            assert duty in said
            assert word in said[duty]


def test_a_node_that_does_not_start_is_told_in_one_line() -> None:
    code, _, stderr = conform("--sim", "--", sys.executable, "-c", "raise SystemExit('no such road')")
    assert code == UNAVAILABLE
    assert "no such road" in stderr
    code, _, stderr = conform("--driver", "--", "no-such-program")
    assert code == CONFIG
    assert stderr.count("\n") == 1


def test_one_of_the_two_roles_is_asked_for() -> None:
    code, _, stderr = conform("--sim", "--driver")
    assert code == 2
    assert "choose one" in stderr
