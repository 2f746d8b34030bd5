"""One way to compile the same source: it finds what a function calls, and keeps the machine code while that holds."""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from schemas.runtime.compiled import cache_folder, compiled, digest

OUTER = """
from typing import NamedTuple

from {name} import inner
from {name}.inner import TWICE, half
import {name}.deep

class Preset(NamedTuple):
    gain: float
    offset: float

def above(x):  # calls what is defined below it
    return below(x)

def below(x):
    return inner.third(half(x)) + {name}.deep.deeper(x)

STEP = below

def total(rows, preset):
    out = 0.0
    for i in range(len(rows)):
        out += preset.gain * STEP(rows[i]) + preset.offset + TWICE * above(rows[i]) + inner.LIMIT[1]
    return out
"""
INNER = """
TWICE = 2.0
LIMIT = (1.0, 3.0)

def half(x):
    return x / 2.0

def third(x):
    return half(x) / 1.5
"""
DEEP = """
def deeper(x):
    return deepest(x) + 1.0

def deepest(x):
    return x * x
"""


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder of the test's own, which does not exist yet."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


Package = Callable[..., ModuleType]


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Package:
    """Writes and imports a package `cars` of the modules outer, inner and deep; returns outer."""
    monkeypatch.syspath_prepend(tmp_path / "source")

    def write(outer: str = OUTER, inner: str = INNER, deep: str = DEEP, name: str = "cars") -> ModuleType:
        folder = tmp_path / "source" / name
        folder.mkdir(parents=True, exist_ok=True)
        for module, text in {"__init__": "", "outer": outer, "inner": inner, "deep": deep}.items():
            (folder / f"{module}.py").write_text(text.replace("{name}", name))
        for loaded in [m for m in sys.modules if m.partition(".")[0] == name]:
            monkeypatch.delitem(sys.modules, loaded)
        importlib.invalidate_caches()
        return importlib.import_module(f"{name}.outer")

    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    return write


ROWS = np.linspace(0.0, 3.0, 7)


def result(outer: ModuleType, function: Any = None) -> float:
    return float((function or outer.total)(ROWS, outer.Preset(2.0, 0.5)))


def hits(function: Any) -> int:
    return sum(function.stats.cache_hits.values())


def test_every_function_that_is_reached_is_compiled_whichever_way_it_is_named(package: Package) -> None:
    outer = package()
    assert result(outer, compiled(outer.total)) == result(outer)


def test_the_originals_stay_plain_python(package: Package) -> None:
    outer = package()
    result(outer, compiled(outer.total))
    assert {type(f) for f in (outer.total, outer.above, outer.STEP, outer.inner.third)} == {type(package)}


def test_a_new_helper_just_works(package: Package) -> None:
    helper = "def third(x):\n    return new(x)\n\ndef new(x):\n    return half(x) - 7.0\n"
    outer = package(inner=INNER.replace("def third", "def unused") + helper)
    assert result(outer, compiled(outer.total)) == result(outer)


def test_inlined_helpers_give_the_same(package: Package) -> None:
    outer = package()
    assert result(outer, compiled(outer.total, inline=True, error_model="numpy")) == result(outer)


def test_a_division_by_zero_raises_as_it_does_where_the_node_drives(package: Package) -> None:
    outer = package(inner=INNER.replace("x / 2.0", "x / (x - x)"))
    with pytest.raises(ZeroDivisionError):
        result(outer, compiled(outer.total))


def test_functions_that_close_over_functions_are_copied_with_them() -> None:
    def helper(x: float) -> float:
        return x + 1.0

    def outer(x: float) -> float:
        return helper(x) * 2.0

    assert compiled(outer)(3.0) == 8.0


def test_functions_that_call_each_other_are_compiled_together(package: Package) -> None:
    circle = "def even(n):\n    return n == 0 or odd(n - 1)\n\ndef odd(n):\n    return n != 0 and even(n - 1)\n"
    outer = package(outer=circle)
    even = compiled(outer.even)
    assert [even(n) for n in range(4)] == [True, False, True, False]


def test_the_second_time_the_machine_code_is_read(package: Package, cache: Path) -> None:
    outer = package()
    first, second = compiled(outer.total), compiled(outer.total)
    assert result(outer, first) == result(outer, second)
    assert (hits(first), hits(second)) == (0, 1)
    assert len(list(cache.iterdir())) == 1


@pytest.mark.parametrize(
    ("module", "before", "after"),
    [
        ("deep", "x * x", "x * x * x"),
        ("inner", "TWICE = 2.0", "TWICE = 2.5"),
        ("inner", "LIMIT = (1.0, 3.0)", "LIMIT = (1.0, 4.0)"),
        ("inner", "x / 2.0", "x / 4.0"),
        ("outer", "STEP = below", "STEP = above"),
    ],
)
def test_a_change_of_what_is_reached_is_another_digest_and_another_result(
    package: Package, module: str, before: str, after: str
) -> None:
    outer = package()
    old, was = digest(outer.total), result(outer, compiled(outer.total))
    text = {"outer": OUTER, "inner": INNER, "deep": DEEP}[module]
    changed = package(**{module: text.replace(before, after)})
    assert digest(changed.total) != old
    assert result(changed, compiled(changed.total)) == result(changed)
    assert (result(changed) == was) == (module == "outer")


def test_what_is_not_reached_and_how_it_is_laid_out_does_not_count(package: Package) -> None:
    old = digest(package().total)
    assert (
        digest(package(inner="# a comment\n\n" + INNER + "\n\nUNUSED = 1\n\ndef unused(x):\n    return x\n").total)
        == old
    )


def test_the_fields_of_a_preset_are_part_of_the_signature(package: Package) -> None:
    outer = package()
    result(outer, compiled(outer.total))
    swapped = package(outer=OUTER.replace("gain: float\n    offset: float", "offset: float\n    gain: float"))
    assert result(swapped, compiled(swapped.total)) == result(swapped)
    assert result(swapped) != result(outer)


@pytest.mark.parametrize("damage", [lambda b: b"", lambda b: b[: len(b) // 2], lambda b: b[:-1] + bytes([b[-1] ^ 1])])
def test_a_damaged_file_is_compiled_anew(package: Package, cache: Path, damage: Callable[[bytes], bytes]) -> None:
    outer = package()
    result(outer, compiled(outer.total))
    (file,) = cache.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    again, after = compiled(outer.total), compiled(outer.total)
    assert result(outer, again) == result(outer, after) == result(outer)
    assert (hits(again), hits(after)) == (0, 1)


def test_a_folder_that_cannot_be_written_is_done_without(package: Package, tmp_path: Path, cache: Path) -> None:
    cache.write_text("a file is in the way")  # permissions would not stop a superuser
    outer = package()
    function = compiled(outer.total)
    assert result(outer, function) == result(outer)
    assert hits(function) == 0
    assert cache.is_file()


def test_without_the_variable_the_cache_is_the_users_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert "fastslow" in cache_folder().parts


def test_two_processes_may_compile_the_same_at_once(package: Package, tmp_path: Path, cache: Path) -> None:
    outer = package()
    code = (
        "import numpy as np; from cars import outer; from schemas.runtime.compiled import compiled;"
        "print(compiled(outer.total)(np.linspace(0.0, 3.0, 7), outer.Preset(2.0, 0.5)))"
    )
    environment = {"PYTHONPATH": f"{Path.cwd()}:{tmp_path / 'source'}", "NUMBA_CACHE_DIR": str(cache), "HOME": "/"}
    both = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment)
        for _ in range(2)
    ]
    assert [float(p.communicate(timeout=120)[0]) for p in both] == [result(outer)] * 2
    assert len(list(cache.iterdir())) == 1
    here = compiled(outer.total)
    assert result(outer, here) == result(outer)
    assert hits(here) == 1
