"""What pip is told of the project, and what our own messages tell people to install."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CODE = ("schemas", "sim_node", "fast_node", "slow_node", "deploy")
TEXTS = [
    *(file for folder in CODE for file in (ROOT / folder).rglob("*.py")),
    *ROOT.glob("*.md"),
    *(ROOT / "docs").glob("*.md"),
]


def test_every_extra_that_a_message_or_page_names_exists():
    named = {
        extra.strip(): text.name
        for text in TEXTS
        for several in re.findall(r"fastslow\[([a-z, ]+)\]", text.read_text(encoding="utf-8"))
        for extra in several.split(",")
    }
    assert named
    assert {extra: where for extra, where in named.items() if extra not in PROJECT["optional-dependencies"]} == {}


def test_the_citation_has_the_version_of_the_package():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.*)$", citation, re.MULTILINE) == [PROJECT["version"]]
