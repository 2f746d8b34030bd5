"""Policies drive the real processes: an outsider's from the current folder, one that fails, and a baseline."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fast_node.policies.mlp import shipped

pytestmark = [pytest.mark.slow, pytest.mark.realtime]
ROOT = Path(__file__).parents[3]
FAILING = """
class Fails:
    calls = 0

    def logits(self, x):
        self.calls += 1
        return x[..., 0, :5] if self.calls < 10 else None

load = Fails
"""
STUCK = """
import threading

class Stuck:
    calls = 0

    def logits(self, x):
        self.calls += 1
        if self.calls > 10:
            threading.Event().wait()
        return x[..., 0, :5]

load = Stuck
"""


def live(folder: Path, spec: str, option: str = "--policy") -> tuple[int, dict[str, Any], set[str], str]:
    """Exit code, summary, who decided as the live lines have it, and stderr of a short run without the slow side."""
    env = {**os.environ, "PYTHONPATH": str(ROOT), "FASTSLOW_DATA": str(folder)}
    run = [sys.executable, "-m", "deploy", "run", "--port", "0", "--json", "--duration", "4"]
    alone = ["--without", "slow", "--without", "llm"]
    told = subprocess.run(
        [*run, *alone, option, spec], cwd=folder, env=env, text=True, capture_output=True, timeout=120
    )
    return told.returncode, json.loads(told.stdout), set(re.findall(r"\| by (\w+)", told.stderr)), told.stderr


@pytest.mark.timeout(150)
def test_the_torch_network_of_contributing_drives_the_live_car_from_a_folder_of_its_own(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    recipe = (ROOT / "CONTRIBUTING.md").read_text("utf-8").partition("## A policy of your own")[2]
    (tmp_path / "mine.py").write_text(recipe.partition("```python\n")[2].partition("```")[0])
    code, summary, sources, _ = live(tmp_path, "mine:load")
    assert (code, summary["collisions"]) == (0, 0)
    assert "policy" in sources


@pytest.mark.timeout(150)
@pytest.mark.parametrize("source", [FAILING, STUCK], ids=["failing", "stuck"])
def test_where_a_stranger_fails_or_hangs_the_live_car_drives_on_by_the_rule(tmp_path: Path, source: str) -> None:
    (tmp_path / "theirs.py").write_text(source)
    code, summary, sources, _ = live(tmp_path, "theirs:load")
    assert (code, summary["collisions"], summary["restarts"]) == (0, 0, 0)
    assert "fallback" in sources


@pytest.mark.timeout(150)
def test_a_baselines_checkpoint_drives_the_live_car(tmp_path: Path) -> None:
    code, summary, sources, _ = live(tmp_path, str(shipped("ppo", "masked")), "--checkpoint")
    assert (code, summary["collisions"]) == (0, 0)
    assert "policy" in sources


@pytest.mark.timeout(150)
def test_a_policy_that_there_is_not_ends_the_run_with_one_line_and_exit_code_78(tmp_path: Path) -> None:
    code, _, _, said = live(tmp_path, "nowhere:load")
    assert code == 78
    assert "fast cannot start: policy nowhere:load: cannot import nowhere" in said
    assert "Traceback" not in said
