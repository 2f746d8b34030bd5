"""One way to compile the functions that drive: the same source, for many scenes at once, kept on disk as machine code.

`compiled(f)` finds by itself every plain Python function that `f` reaches through its globals, makes numba-compiled
copies of all of them, and leaves the originals as they are: the nodes go on running plain Python. What a function calls
may be in any module, and may be named as `f` or as `module.f`.

The machine code is kept in `cache_folder()` under a digest of everything that went into it. Where that folder cannot be
written, or holds a damaged file, the function is compiled in memory and works all the same.
"""

from __future__ import annotations

import dis
import hashlib
import os
import pickle
import platform
import sys
import tempfile
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from types import BuiltinFunctionType, CellType, CodeType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

import llvmlite
import numba
import numpy as np
import platformdirs
from numba import types as numba_types
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

F = TypeVar("F", bound=Callable[..., Any])

KEPT = 32
"""Files of one function in the cache; older ones, of sources that are gone, are removed."""
_FOREIGN = {*sys.stdlib_module_names, "numpy", "numba", "llvmlite"}
"""Packages whose functions numba knows, or that are no business of ours; all others are compiled from their source."""
_VERSIONS = f"{platform.python_version()} {numba.__version__} {llvmlite.__version__} {np.__version__}"


def cache_folder() -> Path:
    """Where machine code is kept: NUMBA_CACHE_DIR, or `fastslow` in the user's cache folder. It may not exist."""
    return Path(os.environ.get("NUMBA_CACHE_DIR") or platformdirs.user_cache_dir("fastslow"))


def compiled(function: F, *, inline: bool = False, **options: Any) -> F:
    """A compiled copy of a plain function and of all that it calls; compiles, or reads the cache, at its first call.

    Call it after everything that `function` calls has been defined. `inline`: the functions that it calls become part
    of its code, which is faster and takes longer to compile. `options`: of `numba.njit`, for all of them; with numba's
    own defaults a division by zero raises, as in plain Python.
    """
    assert isinstance(function, FunctionType)
    dispatcher = _Copies({**options, "forceinline": True} if inline else options).of(function, options)
    try:
        dispatcher._cache = _Disk(f"{function.__module__}.{function.__qualname__}", digest(function, options, inline))
    except _UnknownError:
        pass  # nothing tells one such value from another: its code is not kept
    return cast(F, dispatcher)


def digest(function: Callable[..., Any], *more: Any) -> str:
    """A name for the code of `function` and of all that it reaches: functions, constants, types, versions.

    Raises `_UnknownError` for a global value of which it cannot be told whether it has changed.
    """
    text = hashlib.sha256(repr((_VERSIONS, more)).encode())
    for part in _text(function, set()):
        text.update(part.encode() + b"\0")
    return text.hexdigest()[:24]


class _UnknownError(Exception):
    """A value that two runs cannot be sure to have in common."""


def _is_ours(module: str | None) -> bool:
    return module is not None and module.partition(".")[0] not in _FOREIGN


def _names(code: CodeType) -> tuple[frozenset[str], frozenset[str]]:
    """The globals and the attributes that a function's code names, functions inside it included."""
    loaded: set[str] = set()
    attributes: set[str] = set()
    for step in dis.get_instructions(code):
        if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            loaded.add(step.argval)
        elif step.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            attributes.add(step.argval)
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            more_loaded, more_attributes = _names(inner)
            loaded |= more_loaded
            attributes |= more_attributes
    return frozenset(loaded), frozenset(attributes)


def _reached(function: FunctionType) -> tuple[dict[str, Any], frozenset[str]]:
    """The global values that a function names, and the attributes that it may want of those that are modules."""
    loaded, attributes = _names(function.__code__)
    return {name: function.__globals__[name] for name in sorted(loaded) if name in function.__globals__}, attributes


class _Copies:
    """Compiled copies of functions that call each other, and of the modules that they are called through."""

    def __init__(self, options: dict[str, Any]) -> None:
        """options: of `numba.njit`, for all but the outermost function."""
        self._options = options
        self._made: dict[Any, Any] = {}

    def of(self, function: FunctionType, options: dict[str, Any]) -> Any:
        """A compiled copy of a function, whose globals are compiled copies."""
        scope: dict[str, Any] = {"__name__": function.__module__, "__builtins__": __builtins__}
        cells = tuple(CellType(self._global(cell.cell_contents, frozenset())) for cell in function.__closure__ or ())
        copy = FunctionType(function.__code__, scope, function.__name__, function.__defaults__, cells)
        copy.__qualname__, copy.__kwdefaults__ = function.__qualname__, function.__kwdefaults__
        made = self._made[function] = numba.njit(copy, **options)  # before its globals, which may call it
        known, attributes = _reached(function)
        scope.update({name: self._global(value, attributes) for name, value in known.items()})
        return made

    def _global(self, value: Any, attributes: frozenset[str]) -> Any:
        """What stands for a global value in compiled code; `attributes`: what a module may be asked for."""
        if isinstance(value, FunctionType) and _is_ours(value.__module__):
            return self._made[value] if value in self._made else self.of(value, self._options)
        if isinstance(value, ModuleType) and _is_ours(value.__name__):
            key = value, attributes
            if key not in self._made:
                self._made[key] = stand_in = ModuleType(value.__name__)
                for name in sorted(attributes & value.__dict__.keys()):
                    setattr(stand_in, name, self._global(value.__dict__[name], attributes))
            return self._made[key]
        if isinstance(value, tuple) and any(isinstance(item, FunctionType) for item in value):
            items = [self._global(item, attributes) for item in value]
            return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
        return value


def _text(value: Any, seen: set[Any], attributes: frozenset[str] = frozenset()) -> Iterator[str]:
    """All that makes up a value, functions by their code; in the same order in every run. See `digest`."""
    value = getattr(value, "py_func", getattr(value, "_defn", value))  # what numba has compiled, or generates code with
    yield type(value).__name__
    if isinstance(value, FunctionType) and _is_ours(value.__module__):
        yield f"{value.__module__}.{value.__qualname__}"
        if value in seen:
            return
        seen.add(value)
        yield from _text(value.__code__, seen)
        cells = (cell.cell_contents for cell in value.__closure__ or ())
        yield from _text((value.__defaults__, *sorted((value.__kwdefaults__ or {}).items()), *cells), seen)
        known, wanted = _reached(value)
        for name, found in known.items():
            yield name
            yield from _text(found, seen, wanted)
    elif isinstance(value, CodeType):
        yield f"{value.co_code!r} {value.co_names} {value.co_varnames} {value.co_freevars} {value.co_exceptiontable!r}"
        yield from _text(value.co_consts, seen)
    elif isinstance(value, ModuleType):
        yield value.__name__
        if _is_ours(value.__name__) and (value, attributes) not in seen:
            seen.add((value, attributes))
            for name in sorted(attributes & value.__dict__.keys()):
                yield name
                yield from _text(value.__dict__[name], seen, attributes)
    elif isinstance(value, tuple | list):
        yield f"{getattr(value, '_fields', '')} {len(value)}"
        for item in value:
            yield from _text(item, seen)
    else:
        yield _leaf_text(value)


def _leaf_text(value: Any) -> str:
    """A value that holds nothing else. Raises `_UnknownError` for one that says nothing of what it holds."""
    if isinstance(value, type):
        members = [(m.name, m.value) for m in value] if issubclass(value, Enum) and _is_ours(value.__module__) else ""
        return f"{value.__module__}.{value.__qualname__} {getattr(value, '_fields', '')} {members}"
    if isinstance(value, Enum):
        return f"{type(value).__qualname__}.{value.name} {value.value!r}"
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes()!r}"
    if isinstance(value, frozenset):
        return repr(sorted(map(repr, value)))
    if value is None or value is ... or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        return repr(value)
    if isinstance(value, np.dtype | numba_types.Type):
        return str(value)
    if isinstance(value, FunctionType | BuiltinFunctionType | np.ufunc):
        return f"{getattr(value, '__module__', '')}.{value.__name__}"
    raise _UnknownError(value)


def _type_text(kind: Any) -> str:
    """numba's name of a type, with the class and the fields behind a named tuple, which numba leaves out."""
    if isinstance(kind, numba_types.BaseNamedTuple):
        fields = ", ".join(f"{name}: {_type_text(t)}" for name, t in zip(kind.fields, kind.types, strict=True))
        return f"{kind.instance_class.__module__}.{kind.instance_class.__qualname__}({fields})"
    if isinstance(kind, numba_types.BaseTuple):
        return f"({', '.join(map(_type_text, kind))})"
    return str(kind)


class _Disk(NullCache):  # type: ignore[misc]
    """The machine code of one function in `cache_folder()`, a file per signature: its digest, then its contents."""

    def __init__(self, name: str, digest_: str) -> None:
        self._name = "".join(c for c in name if c.isalnum() or c in "._")
        self._digest = digest_

    @property
    def cache_path(self) -> str:
        return str(cache_folder())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        target_context.refresh()
        try:
            stored = self._file(sig, target_context.codegen()).read_bytes()
        except OSError:
            return None
        if hashlib.sha256(stored[32:]).digest() != stored[:32]:
            return None
        try:
            return CompileResult._rebuild(target_context, *pickle.loads(stored[32:]))
        except Exception:  # whatever is wrong with it: a cache is no reason not to drive
            return None

    def save_overload(self, sig: Any, cres: Any) -> None:
        if cres.lifted or cres.library.has_dynamic_globals:
            return
        contents = dumps(cres._reduce())
        file = self._file(sig, cres.codegen)
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            handle, unfinished = tempfile.mkstemp(dir=file.parent, prefix="unfinished-")
        except OSError:
            return  # no cache: it has been compiled in memory
        try:
            with open(handle, "wb") as out:
                out.write(hashlib.sha256(contents).digest() + contents)
            os.replace(unfinished, file)  # whole or not at all, whoever else compiles the same
            written = sorted(file.parent.glob(f"{self._name}-*"), key=lambda f: f.stat().st_mtime_ns)
            for old in written[:-KEPT]:
                old.unlink(missing_ok=True)
        except OSError:
            Path(unfinished).unlink(missing_ok=True)

    def _file(self, sig: Any, codegen: Any) -> Path:
        arguments = getattr(sig, "args", sig)
        key = repr((self._digest, [_type_text(kind) for kind in arguments], codegen.magic_tuple()))
        return cache_folder() / f"{self._name}-{hashlib.sha256(key.encode()).hexdigest()[:24]}"
