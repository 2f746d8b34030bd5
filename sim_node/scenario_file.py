"""A scenario by its name, or from a TOML file that says how it differs from another.

    base = "highway"            # whose fields count where the file says nothing; without it every field is asked for
    duration_s = 60.0

    [ego]
    speed_mps = [20.0, 25.0]

The fields are those of `Scenario`; a table inside it is merged with the base's, a list takes its place.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import msgspec

from sim_node.scenarios import SCENARIOS, Scenario

FILE = ".toml"


def find_scenario(spec: str) -> Scenario:
    """The scenario of that name, or of the file FILE.toml, called as its file is unless it says otherwise.

    Raises ValueError for what is neither, or for a file that is no scenario.
    """
    if spec in SCENARIOS:
        return SCENARIOS[spec]
    if not spec.endswith(FILE):
        raise ValueError(f"scenario {spec!r} is not one of: {', '.join(SCENARIOS)}; or give a FILE{FILE}")
    try:
        text = Path(spec).read_text(encoding="utf-8")
    except OSError as error:
        raise ValueError(f"scenario file {spec}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ValueError(f"scenario file {spec}: it is no text") from None
    return scenario_of(spec, text)


def scenario_of(file: str, text: str) -> Scenario:
    """The scenario that a file of this name with this text has. Raises ValueError where it has none."""
    path = Path(file)
    try:
        said = tomllib.loads(text)
        base = said.pop("base", None)
        if base is not None and base not in SCENARIOS:
            raise ValueError(f"base {base!r} is not one of: {', '.join(SCENARIOS)}")
        whole = {} if base is None else msgspec.to_builtins(SCENARIOS[base])
        kind = Scenario if base is None else type(SCENARIOS[base])
        whole = _merged(whole, {"name": path.stem, "description": f"of {path.name}", **said})
        scenario: Scenario = msgspec.convert(whole, kind)
        _refuse_unknown(said, msgspec.to_builtins(scenario), "")
        return scenario
    except (ValueError, msgspec.ValidationError) as error:
        raise ValueError(f"scenario file {file}: {error}") from None


def _merged(base: dict[str, Any], said: dict[str, Any]) -> dict[str, Any]:
    both = dict(base)
    for name, value in said.items():
        here = both.get(name)
        both[name] = _merged(here, value) if isinstance(here, dict) and isinstance(value, dict) else value
    return both


def _refuse_unknown(said: Any, known: Any, where: str) -> None:
    """Raise ValueError for the first name in `said` that is no field: a typing error must not pass unseen."""
    if isinstance(said, dict) and isinstance(known, dict):
        for name, value in said.items():
            if name not in known:
                raise ValueError(f"no field {where}{name}: choose from {', '.join(known)}")
            _refuse_unknown(value, known[name], f"{where}{name}.")
    elif isinstance(said, list) and isinstance(known, list | tuple):
        for one, other in zip(said, known, strict=True):
            _refuse_unknown(one, other, where)
