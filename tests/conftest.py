"""What holds for every test: the guards, and how hypothesis draws its examples."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from tests import guards

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the nodes' own __main__ do, before NumPy loads
for name in ("OPENAI_API_KEY", "OPENAI_BASE_URL", "OPENAI_MODEL", "OLLAMA_HOST"):
    os.environ.pop(name, None)  # a developer's own endpoint is no part of a test

# "default" draws the same examples every time, so that one revision of the code has one verdict. To hunt for new
# counter-examples: pytest --hypothesis-profile=search, which draws others each time, and ten times as many.
CALM = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # a busy machine is no finding
settings.register_profile("default", CALM, derandomize=True)
settings.register_profile("search", CALM, derandomize=False, print_blob=True)
settings.load_profile("default")
SEARCH_FACTOR = 10


def pytest_addoption(parser: pytest.Parser) -> None:
    choices = ("too", "without", "alone", "all")
    parser.addoption("--realtime", choices=choices, default="too", help="what becomes of the tests marked `realtime`")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Who wants none but real-time tests need not import the other files."""
    if config.getoption("--realtime") not in ("alone", "all") or collection_path.suffix != ".py":
        return None
    return b"mark.realtime" not in collection_path.read_bytes() or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what `--realtime` does not want. alone: nothing but these, without the thorough ones; all: with them.

    A search draws more examples of each property, whatever number it names for itself.
    """
    if (which := config.getoption("--realtime")) != "too":
        wanted: dict[bool, list[pytest.Item]] = {True: [], False: []}
        for test in items:
            realtime, thorough = (test.get_closest_marker(name) is not None for name in ("realtime", "thorough"))
            ours = not realtime if which == "without" else realtime and (which == "all" or not thorough)
            wanted[ours].append(test)
        config.hook.pytest_deselected(items=wanted[False])
        items[:] = wanted[True]
    if settings.get_current_profile_name() != "search":
        return
    for test in {item.function for item in items if isinstance(item, pytest.Function)}:
        own: Any = getattr(test, "_hypothesis_internal_use_settings", None)
        if own is not None:
            more = settings(own, max_examples=SEARCH_FACTOR * own.max_examples)
            test._hypothesis_internal_use_settings = more


@pytest.fixture(scope="session", autouse=True)
def _guards() -> Iterator[None]:
    with guards.guarded():
        yield


@pytest.fixture(autouse=True)
def _unbroken() -> Iterator[None]:
    """Fails a test that a guard refused something, even where the code swallowed the error."""
    guards.broken.clear()
    yield
    assert guards.broken == []
