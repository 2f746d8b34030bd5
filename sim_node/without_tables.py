"""highway-env, without pandas and matplotlib: it imports both for an observation and a plot that we never ask for.

This is imported before anything that imports highway-env; it saves half a second of every start and 60 MB. Should
highway-env need one of them after all, it is loaded then; whoever imports it later gets the real one.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

SPARED = ("pandas", "matplotlib", "matplotlib.pyplot")


class _Later(ModuleType):
    """Stands for a module until somebody wants something of it."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(import_module(self.__name__), name)


def _load() -> None:
    spared = {name: _Later(name) for name in SPARED if name not in sys.modules}
    if set(spared) != set(SPARED):  # one is here already: there is little to save
        return
    spared["matplotlib"].pyplot = spared["matplotlib.pyplot"]  # type: ignore[attr-defined]
    sys.modules.update(spared)
    try:
        import_module("highway_env.envs")
    finally:
        for name in spared:
            del sys.modules[name]


_load()
