"""Actor-critic with a KL-restricted update (paper Eq. 15-17). Axes: T steps, S scenes."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fast_node.training.network import ActorCritic

Floats = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class LearnerConfig:
    """The paper's gamma (of a second) and learning rate; the rest is ours."""

    gamma: float = 0.99
    lam: float = 0.95
    lr: float = 5e-4
    clip: float = 0.2
    target_kl: float = 0.02
    epochs: int = 6
    minibatch: int = 256
    entropy: float = 0.01
    value_weight: float = 0.5
    max_grad_norm: float = 0.5

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            least = {"epochs": 1, "minibatch": 1}.get(name, 0)
            none = name in ("lr", "clip", "max_grad_norm") and value == 0  # nothing would be learned
            if not least <= value < math.inf or none:
                raise ValueError(f"{name} {value} is not a positive number")
        for name in ("gamma", "lam"):
            if not getattr(self, name) <= 1:
                raise ValueError(f"{name} {getattr(self, name)} is not within 0..1")


def advantages(
    rewards: Floats,
    values: Floats,
    next_values: Floats,
    terminated: NDArray[np.bool_],
    ended: NDArray[np.bool_],
    gamma: float,
    lam: float,
) -> Floats:
    """Generalised advantage estimates (T, S); with lam = 1 the K-step advantage of Eq. 15.

    `next_values` are V(s_{t+1}) of the same episode (before a reset), so a truncated episode is bootstrapped and a
    terminated one is not; `ended` = terminated or truncated cuts the sum.
    """
    out = np.zeros_like(rewards)
    running = np.zeros(rewards.shape[1], np.float32)
    for t in range(len(rewards) - 1, -1, -1):
        delta = rewards[t] + gamma * next_values[t] * ~terminated[t] - values[t]
        running = (delta + gamma * lam * running * ~ended[t]).astype(np.float32)
        out[t] = running
    return out


def following_values(values: Floats, last_values: Floats, ended: NDArray[np.bool_], after: Floats) -> Floats:
    """V(s_{t+1}) (T, S) of the same episode.

    values: V(s_t) of every decision; where an episode ended, the next of them is another's, and `last_values` (T, S)
    has that of the state it ended in; after: (S,) of the state that follows the last decision.
    """
    return np.where(ended, last_values, np.concatenate([values[1:], after[None]]))


def explained_variance(values: Floats, targets: Floats) -> float:
    """Share of the targets' variance that the values account for; nan where the targets are all the same."""
    variance = float(np.var(targets))
    return 1.0 - float(np.var(targets - values)) / variance if variance > 0 else float("nan")


def masked_distribution(logits: Tensor, is_open: Tensor) -> torch.distributions.Categorical:
    """The policy over the open actions only; all five where none is open (the mask brakes, and nothing is learned)."""
    usable = is_open | ~is_open.any(-1, keepdim=True)
    return torch.distributions.Categorical(logits=logits.masked_fill(~usable, -1e9))


def update(
    net: ActorCritic,
    optimizer: torch.optim.Optimizer,
    config: LearnerConfig,
    batch: dict[str, Tensor],
    generator: torch.Generator,
) -> dict[str, float]:
    """One policy update from a batch of x, is_open, action, log_prob, advantage, value_target; returns its losses.

    All are of the last minibatch that was stepped on, but for "clipfrac": the mean over all of the share of ratios
    outside the clip, and "approx_kl": of the last one looked at. The trust region: no step is made from where a
    minibatch's mean KL(old || new), estimated as E[r - 1 - ln r] with r = pi / pi_old, exceeds 1.5 `target_kl`.
    """
    n = len(batch["action"])
    kl = policy_loss = value_loss = entropy = clipped = 0.0
    updates = 0

    def figures() -> dict[str, float]:
        return {
            "approx_kl": kl,
            "policy_loss": policy_loss,
            "value_loss": value_loss,
            "entropy": entropy,
            "clipfrac": clipped / max(updates, 1),
            "updates": updates,
        }

    for _ in range(config.epochs):
        order = torch.randperm(n, generator=generator)
        for index in torch.split(order, config.minibatch):
            b = {k: v[index] for k, v in batch.items()}
            logits, value = net(b["x"])
            dist = masked_distribution(logits, b["is_open"])
            log_ratio = dist.log_prob(b["action"]) - b["log_prob"]
            ratio = log_ratio.exp()
            kl = ((ratio - 1) - log_ratio).mean().item()
            if kl > 1.5 * config.target_kl:
                return figures()
            a = b["advantage"]
            a = (a - a.mean()) / (a.std() + 1e-8)
            loss_pi = -torch.min(ratio * a, ratio.clamp(1 - config.clip, 1 + config.clip) * a).mean()  # for Eq. 16
            loss_v = ((value - b["value_target"]) ** 2).mean()  # Eq. 17
            spread = dist.entropy().mean()
            loss = loss_pi + config.value_weight * loss_v - config.entropy * spread
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), config.max_grad_norm)
            optimizer.step()
            policy_loss, value_loss, entropy = loss_pi.item(), loss_v.item(), spread.item()
            clipped += ((ratio - 1.0).abs() > config.clip).float().mean().item()
            updates += 1
    return figures()
