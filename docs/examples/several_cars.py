"""Several cars on one road, each with its own directive, by PettingZoo's parallel API; random actions.

python docs/examples/several_cars.py --cars 4
"""

from __future__ import annotations

import argparse

import numpy as np

import fastslow


def main(argv: list[str] | None = None) -> dict[str, float]:
    """Returns what every car has earned."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cars", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=20.0)
    given = parser.parse_args(argv)
    env = fastslow.parallel_env("highway", given.cars, duration_s=given.seconds)
    rng = np.random.default_rng(0)
    asked = {
        car: {"speed_mps": float(rng.uniform(15, 28)), "lane": int(rng.integers(4))} for car in env.possible_agents
    }
    _, infos = env.reset(seed=0, options={"directives": asked})
    earned = dict.fromkeys(env.possible_agents, 0.0)
    while env.agents:
        actions = {car: int(rng.choice(np.flatnonzero(infos[car]["action_mask"]))) for car in env.agents}
        _, rewards, _, _, infos = env.step(actions)
        for car, reward in rewards.items():
            earned[car] += reward
    for car, directive in asked.items():
        print(f"{car}: asked for {directive}, earned {earned[car]:.2f}")
    return earned


if __name__ == "__main__":
    main()
