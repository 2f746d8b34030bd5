"""PPO of stable-baselines3, or MaskablePPO of sb3-contrib, on many roads at once; then in the live car.

In this folder:

    python sb3_ppo.py --masked --steps 200000      # or without --masked; learns, saves, evaluates
    fastslow run --policy sb3_ppo:load             # drives the live car with what was saved
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO

import fastslow

SAVED = Path("runs/sb3-ppo.zip")


def learn(scenario: str, steps: int, envs: int, seed: int, masked: bool, saved: Path) -> Any:
    """The model after so many decisions on so many roads at once."""
    roads = fastslow.sb3_vec_env(scenario, envs)
    kind: Any = MaskablePPO if masked else PPO
    model = kind(
        "MlpPolicy", roads, n_steps=32, batch_size=256, learning_rate=5e-4, gamma=0.9966, ent_coef=0.01, seed=seed,
        device="cpu", verbose=0,
    )  # fmt: skip
    model.learn(steps)
    model.save(saved)
    return model


def evaluate(model: Any, name: str, episodes: int, masked: bool) -> tuple[float, float]:
    """Mean return and share of collisions of the greedy policy in episodes that it has not seen."""
    env: Any = gymnasium.make(name)
    returns, crashes = [], 0
    for seed in range(1000, 1000 + episodes):
        (observation, info), over, earned = env.reset(seed=seed), False, 0.0
        while not over:
            masks = {"action_masks": info["action_mask"].astype(bool)} if masked else {}
            action, _ = model.predict(observation, deterministic=True, **masks)
            observation, reward, terminated, truncated, info = env.step(int(action))
            earned, over, crashes = earned + reward, terminated or truncated, crashes + terminated
        returns.append(earned)
    return float(np.mean(returns)), crashes / episodes


class Drives:
    """The policy as the live car takes it: preferences from the features; the car's own mask closes actions."""

    def __init__(self, model: Any) -> None:
        self._policy = model.policy

    def logits(self, x: np.ndarray) -> np.ndarray:
        """(..., 15, 26) -> (..., 5)"""
        flat = torch.as_tensor(np.asarray(x, np.float32).reshape(-1, *x.shape[-2:]))
        with torch.no_grad():
            out = self._policy.get_distribution(flat).distribution.logits.numpy()
        return np.asarray(out.reshape(*x.shape[:-2], 5), np.float32)


def load() -> Drives:
    """For `fastslow run --policy sb3_ppo:load`."""
    for kind in (MaskablePPO, PPO):
        try:
            return Drives(kind.load(SAVED, device="cpu"))
        except (TypeError, ValueError, KeyError):
            continue
    raise ValueError(f"{SAVED} is no model of PPO or MaskablePPO")


def main(argv: list[str] | None = None) -> tuple[float, float]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="highway")
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--masked", action="store_true", help="MaskablePPO, which never chooses a closed action")
    parser.add_argument("--out", type=Path, default=SAVED)
    given = parser.parse_args(argv)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    model = learn(given.scenario, given.steps, given.envs, given.seed, given.masked, given.out)
    names = {scenario: name for name, scenario in fastslow.ENVIRONMENTS.items()}
    earned, crashed = evaluate(model, names[given.scenario], given.episodes, given.masked)
    print(f"{given.out}: return {earned:.2f}, collisions {crashed:.0%} in {given.episodes} episodes")
    return earned, crashed


if __name__ == "__main__":
    main()
