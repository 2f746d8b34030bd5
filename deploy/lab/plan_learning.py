"""Learn how the shipped driver weighs its plans, by the ride score:

    python -m deploy.lab.plan_learning courses --out runs/courses.json

`courses`: the choice of lane and speed; `gaps`: the choice of gap before a lane's end. A generation drives every
candidate through the same episodes, others each time. The file is written after each; run again, it goes on. `fastslow
evaluate --policy courses:runs/courses.json` drives by it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from deploy.lab.agents import behind_the_mask, drive
from deploy.lab.episodes import Directive
from fast_node.policies.courses import COURSES
from fast_node.policies.gaps import GAPS
from fast_node.training.plan_weights import Search
from schemas.runtime.process import CONFIG, OK, ConfigError
from sim_node.scenario_file import find_scenario

FIRST_SEED = 1_000_000
"""Far from the seeds by which anything is judged."""


@dataclass(frozen=True)
class Road:
    """Where it is tried out: so many episodes a generation."""

    name: str
    episodes: int
    directive: Directive = "hurry"


@dataclass(frozen=True)
class Subject:
    """What is learnt, and how."""

    start: dict[str, float]
    """The weights to begin with, all of them."""
    widths: dict[str, float]
    roads: tuple[Road, ...]


_GAPS_START = {name: GAPS.by_hand.get(name, 0.0) / 10.0 for name in GAPS.names} | {"never": 6.0}
_COURSES_START = {name: COURSES.by_hand.get(name, 0.0) for name in COURSES.names}
SUBJECTS = {
    # Costs only matter beside each other: those by hand, a tenth as large; what never opens costs more than what does.
    "gaps": Subject(
        _GAPS_START,
        {name: max(0.2, 0.1 * abs(value)) for name, value in _GAPS_START.items()},
        (Road("merge-natural", 256), Road("merge", 128), Road("roadworks", 96)),
    ),
    "courses": Subject(
        _COURSES_START,
        {name: max(0.06, 0.3 * abs(value)) for name, value in _COURSES_START.items()},
        (
            Road("highway", 64),
            Road("highway-natural", 72),
            Road("highway-natural", 32, "random"),
            Road("roadworks", 40),
            Road("merge-main", 32),
            Road("merge-natural", 40),
            Road("merge", 32),
        ),
    ),
}


def worth(spec: str, roads: Sequence[Road], generation: int) -> float:
    """The mean ride score of a policy, every road counting the same."""
    means = []
    for road in roads:
        first = FIRST_SEED + generation * road.episodes
        seeds = range(first, first + road.episodes)
        results = drive(behind_the_mask(spec), find_scenario(road.name), seeds, directive=road.directive)
        means.append(float(np.mean([result.ride_score for result in results])))
    return float(np.mean(means))


def learn(what: str, out: Path, generations: int, seed: int) -> None:
    """Search until `generations` have been driven in all. Raises `ConfigError`."""
    subject = SUBJECTS[what]
    search = Search(subject.start, subject.widths, 0, seed).resume(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "weights.json"

        def tried(weights: dict[str, float]) -> float:
            path.write_bytes(msgspec.json.encode({"weights": weights}))
            return worth(f"{what}:{path}", subject.roads, search.generation)

        while search.generation < generations:
            began = time.monotonic()
            by_hand, mean = worth(what, subject.roads, search.generation), tried(search.weights)
            search.tell(np.array([tried(one) for one in search.candidates()]))
            roads = [msgspec.to_builtins(road) for road in subject.roads]
            search.save(out, {"roads": roads, "last": {"by_hand": by_hand, "learnt": mean}})
            left = (generations - search.generation) * (time.monotonic() - began) / 60.0
            print(
                f"{search.generation}/{generations} ride score {mean:.2f}, by hand {by_hand:.2f}; {left:.0f} min left",
                file=sys.stderr,
                flush=True,
            )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=SUBJECTS)
    parser.add_argument("--out", type=Path, required=True, help="where the weights go; gone on with if it exists")
    parser.add_argument("--generations", type=int, default=24, help="in all (default 24)")
    parser.add_argument("--seed", type=int, default=0, help="of the candidates (default 0)")
    options = parser.parse_args()
    try:
        learn(options.what, options.out, options.generations, options.seed)
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    return OK


if __name__ == "__main__":
    sys.exit(main())
