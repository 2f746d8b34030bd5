"""docs/gymnasium.md: every block of Python runs, and what it says of settings is so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from deploy.environments.config import EnvConfig

PAGE = (Path(__file__).parents[3] / "docs" / "gymnasium.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_every_block_runs(block: str) -> None:
    if "parallel_env" in block:
        pytest.importorskip("pettingzoo")
    exec(block, {})


def test_every_setting_is_on_the_page() -> None:
    table = PAGE.split("| setting |")[1].split("\n\n")[0]
    named = {name for row in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    assert named == set(EnvConfig.__struct_fields__)
