"""Learning from a teacher: what `Foresight` does in many situations, imitated before, or in the place of, learning by
reward (DAgger, Ross et al. 2011: the situations are more and more those that the pupil gets itself into)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch.nn import functional

from fast_node.policies.policy import Policy
from fast_node.training.foresight import Foresight
from fast_node.training.learner import masked_distribution
from fast_node.training.network import ActorCritic
from fast_node.training.rollout import Bools, Floats, Ints, Scenes
from schemas.driving.features import Array

EVERY = 3
HARMLESS, MATTERS = 0.1, 0.02
"""A situation in which nothing else would have earned less weighs this much; one in which the second best action would
have earned this much less weighs 1."""


@dataclass(frozen=True)
class Lessons:
    """Situations, what was possible in them, what the teacher did, and how much that mattered."""

    x: Array
    """(N, V, F) policy input."""
    is_open: Bools
    """(N, 5)"""
    action: Ints
    weight: Array
    """(N,) 0 to 1."""

    @staticmethod
    def together(lessons: list[Lessons]) -> Lessons:
        """All of them in one."""
        return Lessons(
            np.concatenate([one.x for one in lessons]),
            np.concatenate([one.is_open for one in lessons]),
            np.concatenate([one.action for one in lessons]),
            np.concatenate([one.weight for one in lessons]),
        )


def lessons_of(scenes: Scenes, teacher: Foresight, pupil: Policy, decisions: int, seed: int, share: float) -> Lessons:
    """Note what the teacher does in `decisions` situations of every scene, `EVERY` decisions apart.

    pupil: has `logits`; it drives in between, and in all but a `share` of the situations.
    """
    rng = np.random.default_rng(seed)
    s = len(scenes.wish)
    kept: list[tuple[Array, Bools, Ints, Array]] = []
    for _ in range(decisions):
        x, is_open = scenes.observe(), scenes.open()
        action, earned = teacher.actions()
        kept.append((x, is_open, action, weights(earned, teacher.first, action)))
        led = rng.random(s) < share
        for k in range(EVERY):
            own = np.where(scenes.open(), pupil.logits(scenes.observe()), -np.inf).argmax(-1)
            _, terminated, truncated = scenes.decide(np.where(led & (k == 0), action, own))
            if (ended := terminated | truncated).any():
                scenes.reset(ended)
    return Lessons(*(np.concatenate(column) for column in zip(*kept, strict=True)))


def weights(earned: Floats, first: Ints, action: Ints) -> Array:
    """(S,) how much it matters that `action` (S,) is taken: by what the best plan that begins otherwise earns less.

    earned, first: (S, plans) what each plan earns, and with which action it begins.
    """
    same = first == action[:, None]
    best = np.where(same, earned, -np.inf).max(-1)
    other = np.where(same, -np.inf, earned).max(-1)
    lost = np.where(np.isfinite(other), best - other, 0.0)
    return np.clip(HARMLESS + (1.0 - HARMLESS) * lost / MATTERS, HARMLESS, 1.0).astype(np.float32)


def learn(net: ActorCritic, lessons: Lessons, *, epochs: int, lr: float, seed: int, minibatch: int = 512) -> float:
    """Fit the policy to the lessons by weighted cross-entropy over what is open; returns the last epoch's mean loss."""
    generator = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.Adam(net.parameters(), lr=lr, eps=1e-5)
    x, is_open = torch.from_numpy(lessons.x), torch.from_numpy(lessons.is_open)
    action, weight = torch.from_numpy(lessons.action), torch.from_numpy(lessons.weight)
    used = int(np.flatnonzero(lessons.x[..., 0].any(0))[-1]) + 1
    x = x[:, :used]
    steps, loss_sum = max(len(x) // minibatch, 1), 0.0
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs * steps, lr * 0.02)
    for _ in range(epochs):
        loss_sum = 0.0
        for batch in torch.randperm(len(x), generator=generator).split(minibatch):
            logits, _ = net(x[batch])
            dist = masked_distribution(logits, is_open[batch])
            loss = functional.nll_loss(dist.logits, action[batch], reduction="none")
            loss = (loss * weight[batch]).sum() / weight[batch].sum()
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 0.5)
            optimizer.step()
            loss_sum += float(loss.detach())
            if schedule.last_epoch < epochs * steps - 1:
                schedule.step()
    return loss_sum / steps
