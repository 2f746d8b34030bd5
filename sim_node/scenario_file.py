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

from schemas.runtime.errors import ConfigError
from schemas.runtime.files import read_text_bounded
from schemas.wire.text import plain
from sim_node.scenarios import SCENARIOS, Scenario

FILE = ".toml"
MOST_ENTRIES, MOST_LETTERS, MOST_NUMBER, MOST_LANES = 200, 1000, 1e5, 16


def find_scenario(spec: str) -> Scenario:
    """The scenario of that name, or of the file FILE.toml, called as its file is unless it says otherwise.

    Raises ValueError for what is neither, or for a file that is no scenario.
    """
    if spec in SCENARIOS:
        return SCENARIOS[spec]
    if not spec.endswith(FILE):
        raise ValueError(f"scenario {spec!r} is not one of: {', '.join(SCENARIOS)}; or give a FILE{FILE}")
    try:
        text = read_text_bounded(Path(spec))
    except ConfigError as error:
        raise ValueError(str(error)) from None
    return scenario_of(spec, text)


def scenario_of(file: str, text: str) -> Scenario:
    """The scenario that a file of this name with this text has. Raises ValueError where it has none."""
    path = Path(file)
    try:
        said = tomllib.loads(text)
        base = said.pop("base", None)
        _refuse_unbounded(said, "")
        if base is not None and not (isinstance(base, str) and base in SCENARIOS):
            raise ValueError(f"base {base!r} is not one of: {', '.join(SCENARIOS)}")
        whole = {} if base is None else msgspec.to_builtins(SCENARIOS[base])
        kind = Scenario if base is None else type(SCENARIOS[base])
        whole = _merged(whole, {"name": path.stem, "description": f"of {path.name}", **said})
        scenario: Scenario = msgspec.convert(whole, kind)
        _refuse_unknown(said, msgspec.to_builtins(scenario), "")
        _refuse_absurd(scenario)
        return scenario
    except RecursionError:
        raise ValueError(f"scenario file {file}: it is nested too deep") from None
    except (ValueError, msgspec.ValidationError) as error:
        raise ValueError(f"scenario file {file}: {plain(str(error), 300)}") from None


def _refuse_unbounded(said: Any, where: str) -> None:
    """Raise ValueError for a number, a text or a list that no road needs."""
    if isinstance(said, dict | list):
        if len(said) > MOST_ENTRIES:
            raise ValueError(f"{where or 'the file'} has {len(said)} entries: at most {MOST_ENTRIES}")
        for name, value in said.items() if isinstance(said, dict) else enumerate(said):
            _refuse_unbounded(value, f"{where}{'.' if where else ''}{name}")
    elif isinstance(said, str) and not (said.strip() and len(said) <= MOST_LETTERS):
        raise ValueError(f"{where} has {len(said)} letters: give 1 to {MOST_LETTERS}")
    elif isinstance(said, int | float) and not abs(said) <= MOST_NUMBER:
        raise ValueError(f"{where} is not within -{MOST_NUMBER:.0f}..{MOST_NUMBER:.0f}")


def _refuse_absurd(scenario: Scenario) -> None:
    """Raise ValueError for what has the right type and cannot be driven."""
    within = [
        ("duration_s", scenario.duration_s, 1.0, 3600.0),
        ("sight_m", scenario.sight_m, 10.0, 1000.0),
        ("ego.speed_mps", scenario.ego.speed_mps, 0.0, 60.0),
        ("ego.speed_ceiling_mps", scenario.ego.speed_ceiling_mps, 1.0, 60.0),
        ("ego.speed_floor_mps", scenario.ego.speed_floor_mps, 0.0, scenario.ego.speed_ceiling_mps),
        *(("lanes.speed_limit_mps", lane.speed_limit_mps, 1.0, 60.0) for lane in scenario.lanes),
        *(("lanes.width_m", lane.width_m, 2.0, 10.0) for lane in scenario.lanes),
        *(("flows.count", flow.count, 0, 200) for flow in scenario.flows),
        *(("flows.speed_mps", flow.speed_mps, 0.0, 60.0) for flow in scenario.flows),
        *(("flows.probability", flow.probability, 0.0, 1.0) for flow in scenario.flows),
    ]
    for name, value, least, most in within:
        low, high = value if isinstance(value, tuple) else (value, value)
        if not least <= low <= high <= most:
            raise ValueError(f"{name} {value} is not within {least}..{most}, the smaller number first")
    if len(scenario.lanes) > MOST_LANES:
        raise ValueError(f"it has {len(scenario.lanes)} lanes: at most {MOST_LANES}")


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
