"""PPO in one file, in CleanRL's style, on `make_vec` with the action mask; curves in TensorBoard.

python docs/examples/cleanrl_ppo.py --env-id fastslow/Merge-v0 --total-timesteps 200000
tensorboard --logdir runs
"""

from __future__ import annotations

import argparse
import random
import time
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical
from torch.utils.tensorboard import SummaryWriter

import fastslow  # noqa: F401 - registers the environments


def layer_init(layer: nn.Linear, std: float = 2**0.5) -> nn.Linear:
    nn.init.orthogonal_(layer.weight, std)
    nn.init.zeros_(layer.bias)
    return layer


class Agent(nn.Module):
    """Policy and value from the flat observation; closed actions have no probability."""

    def __init__(self, envs: Any) -> None:
        super().__init__()
        size, actions = int(np.prod(envs.single_observation_space.shape)), int(envs.single_action_space.n)

        def body(out: int, std: float) -> nn.Sequential:
            return nn.Sequential(
                nn.Flatten(), layer_init(nn.Linear(size, 128)), nn.Tanh(), layer_init(nn.Linear(128, 128)), nn.Tanh(),
                layer_init(nn.Linear(128, out), std),
            )  # fmt: skip

        self.critic, self.actor = body(1, 1.0), body(actions, 0.01)

    def get_value(self, x: torch.Tensor) -> torch.Tensor:
        return torch.as_tensor(self.critic(x)).flatten()

    def get_action_and_value(
        self, x: torch.Tensor, mask: torch.Tensor, action: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        probs = Categorical(logits=self.actor(x).masked_fill(mask == 0, -1e9))
        action = probs.sample() if action is None else action
        return action, probs.log_prob(action), probs.entropy(), self.get_value(x)


def parse_args(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in {
        "env_id": "fastslow/Highway-v0", "exp_name": "cleanrl_ppo", "seed": 1, "total_timesteps": 200_000,
        "learning_rate": 5e-4, "num_envs": 64, "num_steps": 32, "gamma": 0.9966, "gae_lambda": 0.95,
        "num_minibatches": 8, "update_epochs": 6, "clip_coef": 0.2, "ent_coef": 0.01, "vf_coef": 0.5,
        "max_grad_norm": 0.5, "runs": "runs",
    }.items():  # fmt: skip
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(default), default=default)
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> float:
    """Returns the mean return of the last 200 episodes, nan without one."""
    args = parse_args(argv)
    random.seed(args.seed)
    np.random.seed(args.seed)
    torch.manual_seed(args.seed)

    # SAME_STEP: an ended episode is followed by the next in the same step, as CleanRL's loop expects.
    envs: Any = gym.make_vec(args.env_id, num_envs=args.num_envs, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)
    envs = gym.wrappers.vector.RecordEpisodeStatistics(envs, buffer_length=200)
    name = f"{args.env_id.replace('/', '-')}__{args.exp_name}__{args.seed}__{int(time.time())}"
    writer = SummaryWriter(str(Path(args.runs) / name))
    agent = Agent(envs)
    optimizer = torch.optim.Adam(agent.parameters(), lr=args.learning_rate, eps=1e-5)

    steps, n = args.num_steps, args.num_envs
    obs = torch.zeros((steps, n, *envs.single_observation_space.shape))
    masks = torch.zeros((steps, n, envs.single_action_space.n))
    actions = torch.zeros((steps, n), dtype=torch.long)
    logprobs, rewards, dones, values = (torch.zeros((steps, n)) for _ in range(4))

    seen, infos = envs.reset(seed=args.seed)
    next_obs, next_mask, next_done = torch.as_tensor(seen), torch.as_tensor(infos["action_mask"]), torch.zeros(n)
    global_step, start = 0, time.time()
    updates = max(args.total_timesteps // (steps * n), 1)
    for update in range(updates):
        optimizer.param_groups[0]["lr"] = args.learning_rate * (1.0 - update / updates)
        for step in range(steps):
            global_step += n
            obs[step], masks[step], dones[step] = next_obs, next_mask, next_done
            with torch.no_grad():
                action, logprob, _, values[step] = agent.get_action_and_value(next_obs, next_mask)
            actions[step], logprobs[step] = action, logprob
            seen, reward, terminated, truncated, infos = envs.step(action.numpy())
            rewards[step] = torch.as_tensor(reward, dtype=torch.float32)
            if truncated.any():  # cut off, not over: what would come after is worth what the value says
                last = torch.as_tensor(np.stack(list(infos["final_obs"][truncated])))
                with torch.no_grad():
                    rewards[step, torch.as_tensor(truncated)] += args.gamma * agent.get_value(last)
            next_obs, next_mask = torch.as_tensor(seen), torch.as_tensor(infos["action_mask"])
            next_done = torch.as_tensor(terminated | truncated, dtype=torch.float32)

        with torch.no_grad():
            next_value = agent.get_value(next_obs)
            advantages, running = torch.zeros_like(rewards), torch.zeros(n)
            for t in reversed(range(steps)):
                going = 1.0 - (next_done if t == steps - 1 else dones[t + 1])
                following = next_value if t == steps - 1 else values[t + 1]
                delta = rewards[t] + args.gamma * following * going - values[t]
                advantages[t] = running = delta + args.gamma * args.gae_lambda * going * running
            returns = advantages + values

        flat = [a.reshape(-1, *a.shape[2:]) for a in (obs, masks, actions, logprobs, advantages, returns)]
        for _ in range(args.update_epochs):
            for index in torch.randperm(steps * n).chunk(args.num_minibatches):
                b_obs, b_mask, b_action, b_logprob, b_advantage, b_return = (a[index] for a in flat)
                _, logprob, entropy, value = agent.get_action_and_value(b_obs, b_mask, b_action)
                ratio = (logprob - b_logprob).exp()
                a = (b_advantage - b_advantage.mean()) / (b_advantage.std() + 1e-8)
                pg_loss = -torch.min(a * ratio, a * ratio.clamp(1 - args.clip_coef, 1 + args.clip_coef)).mean()
                v_loss = 0.5 * ((value - b_return) ** 2).mean()
                loss = pg_loss - args.ent_coef * entropy.mean() + args.vf_coef * v_loss
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), args.max_grad_norm)
                optimizer.step()

        writer.add_scalar("losses/policy_loss", pg_loss.item(), global_step)
        writer.add_scalar("losses/value_loss", v_loss.item(), global_step)
        writer.add_scalar("charts/SPS", global_step / (time.time() - start), global_step)
        if len(envs.return_queue):
            writer.add_scalar("charts/episodic_return", float(np.mean(envs.return_queue)), global_step)
    torch.save(agent.state_dict(), Path(writer.log_dir) / "agent.pt")
    writer.close()
    envs.close()
    earned = float(np.mean(envs.return_queue)) if len(envs.return_queue) else float("nan")
    rate = global_step / (time.time() - start)
    print(f"{writer.log_dir}: {global_step} decisions, {rate:.0f} a second, return {earned:.2f}")
    return earned


if __name__ == "__main__":
    main()
