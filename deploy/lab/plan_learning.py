"""Learn how the shipped driver weighs its plans before a lane's end, by the ride score:

    python -m deploy.lab.plan_learning --generations 24 --out runs/plans.json

A generation drives every candidate through the same episodes, others each time. The file is written after each; run
again, it goes on. `fastslow evaluate --policy gaps:runs/plans.json` drives by it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from deploy.lab.agents import behind_the_mask, drive
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


ROADS = (Road("merge-natural", 256), Road("merge", 128), Road("roadworks", 96))


def worth(spec: str, generation: int) -> float:
    """The mean ride score of a policy, every road counting the same."""
    means = []
    for road in ROADS:
        first = FIRST_SEED + generation * road.episodes
        seeds = range(first, first + road.episodes)
        results = drive(behind_the_mask(spec), find_scenario(road.name), seeds)
        means.append(float(np.mean([result.ride_score for result in results])))
    return float(np.mean(means))


def learn(out: Path, generations: int, seed: int) -> None:
    """Search until `generations` have been driven in all. Raises `ConfigError`."""
    search = Search.resume(out, seed)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plans.json"

        def tried(weights: dict[str, float]) -> float:
            path.write_bytes(msgspec.json.encode({"weights": weights}))
            return worth(f"gaps:{path}", search.generation)

        while search.generation < generations:
            began = time.monotonic()
            by_hand, mean = worth("gaps", search.generation), tried(search.weights)
            search.tell(np.array([tried(one) for one in search.candidates()]))
            roads = {road.name: road.episodes for road in ROADS}
            search.save(out, {"roads": roads, "last": {"by_hand": by_hand, "learnt": mean}})
            left = (generations - search.generation) * (time.monotonic() - began) / 60.0
            print(
                f"{search.generation}/{generations} ride score {mean:.2f}, by hand {by_hand:.2f}; {left:.0f} min left",
                file=sys.stderr,
                flush=True,
            )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="where the weights go; gone on with if it exists")
    parser.add_argument("--generations", type=int, default=24, help="in all (default 24)")
    parser.add_argument("--seed", type=int, default=0, help="of the candidates (default 0)")
    options = parser.parse_args()
    try:
        learn(options.out, options.generations, options.seed)
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    return OK


if __name__ == "__main__":
    sys.exit(main())
