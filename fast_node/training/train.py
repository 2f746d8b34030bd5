"""`fastslow train`: learn one policy for several scenarios, export it as safetensors with a JSON sidecar."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file

from fast_node.mask import VERSION as MASK_VERSION
from fast_node.policy import load_policy
from fast_node.training.learner import LearnerConfig, advantages, masked_distribution, update
from fast_node.training.network import ActorCritic
from fast_node.training.rollout import Mixed
from schemas.features import FEATURES, LAYOUT_HASH, N_ROWS

WIDTH, HEADS, LAYERS = 128, 2, 1
ROLLOUT = 16


def train(
    scenes: Mixed, out: Path, *, steps: int, seed: int, progress: Callable[[int, dict[str, float]], None],
    config: LearnerConfig | None = None,
) -> dict[str, float]:
    """Train for `steps` decisions and export to `out` (.safetensors). Returns the last figures.

    The learning rate falls linearly to a tenth: the policy that is exported is the last one.
    """
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(seed)
    config = config or LearnerConfig()
    net = ActorCritic(WIDTH, HEADS, LAYERS)
    optimizer = torch.optim.Adam(net.parameters(), lr=config.lr, eps=1e-5)
    x, is_open = scenes.observe()
    s = len(x)
    done, figures, started = 0, {}, time.perf_counter()
    episode_returns: list[float] = []
    crashes: list[bool] = []
    while done < steps:
        for group in optimizer.param_groups:
            group["lr"] = config.lr * max(0.1, 1.0 - done / steps)
        keep: dict[str, list[np.ndarray]] = {k: [] for k in (
            "x", "is_open", "action", "log_prob", "value", "next_value", "reward", "terminated", "ended")}
        for _ in range(ROLLOUT):
            with torch.no_grad():
                logits, value = net(torch.from_numpy(x))
                dist = masked_distribution(logits, torch.from_numpy(is_open))
                action = dist.sample()
                log_prob = dist.log_prob(action)
            reward, terminated, truncated = scenes.decide(action.numpy())
            ended = terminated | truncated
            next_x, next_open = scenes.observe()
            with torch.no_grad():
                next_value = net(torch.from_numpy(next_x))[1].numpy()
            for k, v in (("x", x), ("is_open", is_open), ("action", action.numpy()), ("log_prob", log_prob.numpy()),
                         ("value", value.numpy()), ("next_value", next_value), ("reward", reward),
                         ("terminated", terminated), ("ended", ended)):
                keep[k].append(v)
            if ended.any():
                episode_returns += scenes.returns[ended].tolist()
                crashes += terminated[ended].tolist()
                scenes.reset(ended)
                next_x, next_open = scenes.observe()
            x, is_open = next_x, next_open
        done += ROLLOUT * s
        b = {k: np.stack(v) for k, v in keep.items()}
        advantage = advantages(b["reward"], b["value"], b["next_value"], b["terminated"], b["ended"],
                               config.gamma, config.lam)
        flat = {k: torch.from_numpy(b[k].reshape(-1, *b[k].shape[2:])) for k in ("x", "is_open", "action", "log_prob")}
        flat["advantage"] = torch.from_numpy(advantage.reshape(-1))
        flat["value_target"] = torch.from_numpy((advantage + b["value"]).reshape(-1))
        figures = update(net, optimizer, config, flat, generator)
        figures["episodic_return"] = float(np.mean(episode_returns[-200:])) if episode_returns else float("nan")
        figures["crash_rate"] = float(np.mean(crashes[-200:])) if crashes else float("nan")
        figures["SPS"] = done / (time.perf_counter() - started)
        progress(done, figures)
    export(net, out, {"steps": done, "seed": seed, "learner": asdict(config),
                      "scenarios": [part.task.name for part in scenes.parts],
                      "metrics": {k: round(v, 4) for k, v in figures.items() if k != "SPS"}})
    return figures


def export(net: ActorCritic, out: Path, sidecar: dict[str, object], observations: int = 1000) -> None:
    """Write weights and sidecar, and check the NumPy policy against torch; raises `ValueError` beyond 1e-4."""
    out.parent.mkdir(parents=True, exist_ok=True)
    save_file({k: v.contiguous() for k, v in net.state_dict().items() if not k.startswith("value")}, out)
    out.with_suffix(".json").write_text(json.dumps({
        "layout_hash": LAYOUT_HASH, "features": FEATURES, "mask": MASK_VERSION, "layers": LAYERS, "heads": HEADS,
        "width": WIDTH, **sidecar}, indent=1) + "\n")
    policy = load_policy(out)
    x = np.random.default_rng(0).normal(size=(observations, N_ROWS, len(FEATURES))).astype(np.float32)
    x[:, :, 0] = np.random.default_rng(1).random((observations, N_ROWS)) < 0.7
    x[:, 0, 0] = 1.0
    with torch.no_grad():
        expected = net(torch.from_numpy(x))[0].numpy()
    worst = max(float(np.abs(policy.logits(a) - b).max()) for a, b in zip(x, expected, strict=True))
    if worst > 1e-4:
        raise ValueError(f"the exported policy differs from the trained one by {worst:.1e}")
