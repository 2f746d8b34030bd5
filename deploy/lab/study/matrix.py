"""The matrix of a study or of a search for settings: what is missing is run, what came of it is written."""

from __future__ import annotations

import importlib.util
import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import mean
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from deploy.lab.farm import Farm
from deploy.lab.files import write_table
from deploy.lab.study.cells import ALGORITHMS, EPISODES, ROADS, SEEDS, STEPS, Cell, cells_of, finished, keep, run_away
from deploy.lab.study.report import plot, search_rows, search_table, summary_of, table
from fast_node.policies.mlp import BASELINES, VARIANTS
from schemas.runtime.process import ConfigError

SCHEMA = "fastslow.study/1"
QUICK_SCENARIO, QUICK_SEEDS, QUICK_STEPS = "two-way", (0, 1, 2), 10_000
QUICK_RETURN = 3.0
"""`--quick` fails below this mean return; seeds 0 to 4 reached 3.34 each, and had -6.6 to 2.5 before they learnt."""
AT_HOME = Farm(jobs=2)
SEARCH_SCHEMA, SEARCH_SEED = "fastslow.search/1", 100


def run_study(
    out: Path,
    *,
    algorithms: Sequence[str] = ALGORITHMS,
    variants: Sequence[str] = VARIANTS,
    scenarios: Sequence[str] = ROADS,
    seeds: Sequence[int] = SEEDS,
    steps: int = STEPS,
    farm: Farm = AT_HOME,
    quick: bool = False,
    as_json: bool = False,
) -> int:
    """Run what is missing of the matrix on `farm`; write study.json, study.csv and study.png; print the table.

    Finished cells are kept in `out`/cells and skipped. `quick`: our learner on one road, 10,000 decisions, always anew
    and in `out`/quick alone, which is emptied first; the exit code is 1 if it learns too little. Raises ValueError for
    unknown names, and `ConfigError` for a package that is missing.
    """
    if quick:
        out = out / "quick"
        algorithms, scenarios, seeds, steps = ("ours",), (QUICK_SCENARIO,), QUICK_SEEDS, QUICK_STEPS
    cells = cells_of(algorithms, scenarios, seeds, steps, EPISODES, variants)
    needed("torch", "train")
    needed("matplotlib", "train")
    if any(c.algorithm != "ours" for c in cells):
        needed("stable_baselines3", "baselines")
    if quick and out.exists():
        shutil.rmtree(out)
    out.mkdir(parents=True, exist_ok=True)
    results = run_cells(cells, out / "cells", farm)
    rows = summary_of(results)
    study = {"schema": SCHEMA, "cells": results, "summary": rows}
    (out / "study.json").write_text(json.dumps(study, indent=1) + "\n")
    write_table(rows, out / "study.csv")
    plot(results, out / "study.png")
    print(json.dumps(study) if as_json else table(rows))
    if not quick:
        return 0
    reached = mean(r["curve"][-1][1] for r in results)
    print(f"return {reached:.3f}, at least {QUICK_RETURN} wanted", file=sys.stderr)
    return int(reached < QUICK_RETURN)


def run_search(
    out: Path,
    *,
    algorithms: Sequence[str] = BASELINES,
    scenarios: Sequence[str] = ROADS,
    variants: Sequence[str] = VARIANTS,
    seeds: int = 1,
    steps: int = STEPS,
    farm: Farm = AT_HOME,
    as_json: bool = False,
) -> int:
    """Try each baseline's `TRIALS` on seeds that the study does not use, and say which settings earn most.

    Writes `out`/search.json and prints the table. Raises ValueError for unknown names and for ours, which has no
    trials, and `ConfigError` for a package that is missing.
    """
    if "ours" in algorithms:
        raise ValueError("the search is for the baselines: leave ours out")
    needed("torch", "train")
    needed("stable_baselines3", "train")
    from fast_node.training.baselines import CHOSEN, TRIALS

    plain = cells_of(algorithms, scenarios, [SEARCH_SEED + k for k in range(seeds)], steps, variants=variants)
    cells = [replace(cell, trial=trial) for cell in plain for trial in TRIALS[cell.algorithm]]
    results = run_cells(cells, out / "cells", farm)
    rows = search_rows(results)
    search = {"schema": SEARCH_SCHEMA, "cells": results, "rows": rows}
    (out / "search.json").write_text(json.dumps(search, indent=1) + "\n")
    print(json.dumps(search) if as_json else search_table(rows, CHOSEN))
    return 0


def needed(package: str, extra: str) -> None:
    """Raises `ConfigError` that names the extra to install for a package that is missing."""
    if importlib.util.find_spec(package) is None:
        raise ConfigError(f"{package} is missing: pip install 'fastslow[{extra}]'")


def run_cells(cells: Sequence[Cell], folder: Path, farm: Farm) -> list[dict[str, Any]]:
    """The results of all cells, in order; those that have none yet are run. Ctrl-C ends the processes."""
    folder.mkdir(parents=True, exist_ok=True)
    results = {cell: result for cell in cells if (result := finished(cell, folder)) is not None}
    todo = [cell for cell in cells if cell not in results]
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(file=sys.stderr), speed_estimate_period=3600.0, disable=not todo) as bar:
        task = bar.add_task("study", total=len(cells), completed=len(results))
        for place, (result, files) in farm.run(run_away, [(cell,) for cell in todo]):
            cell = todo[place]
            keep(cell, files, folder)
            results[cell] = result
            bar.update(task, advance=1, description=cell.name)
    return [results[cell] for cell in cells]
