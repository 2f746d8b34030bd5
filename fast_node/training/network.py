"""The paper's attention network (Eq. 10-12) with a value head. Axes: B batch, N rows, F features, D width."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from schemas.features import FEATURES
from schemas.messages import POLICY_ACTIONS


class Encoder(nn.Module):
    """z <- z + MHSA(norm z) + FFN(norm z): Eq. 11 with a pre-norm and a residual term, our departure, for stability."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.up = nn.Linear(width, 2 * width)
        self.down = nn.Linear(2 * width, width)

    def forward(self, z: Tensor, present: Tensor, ego_only: bool = False) -> Tensor:
        """(B, N, D) -> (B, N, D), or (B, 1, D) where only the ego asks: exact, for nothing else is read out."""
        b, n, d = z.shape
        u = self.norm(z)
        asks = u[:, :1] if ego_only else u
        m = asks.shape[1]
        weight, bias = self.qkv.weight, self.qkv.bias
        q = nn.functional.linear(asks, weight[:d], bias[:d]).view(b, m, self.heads, d // self.heads).transpose(1, 2)
        k, v = (a.view(b, n, self.heads, d // self.heads).transpose(1, 2)
                for a in nn.functional.linear(u, weight[d:], bias[d:]).chunk(2, -1))
        attended = nn.functional.scaled_dot_product_attention(q, k, v, attn_mask=present[:, None, None, :])
        return torch.as_tensor(
            z[:, :m] + self.out(attended.transpose(1, 2).reshape(b, m, d)) + self.down(torch.relu(self.up(asks))))


class ActorCritic(nn.Module):
    """(B, N, F) -> logits (B, 5), value (B,). Only `policy`, `embed` and `layers` are exported."""

    def __init__(self, width: int = 128, heads: int = 2, layers: int = 1) -> None:
        super().__init__()
        self.embed = nn.Linear(len(FEATURES), width)
        self.layers = nn.ModuleList(Encoder(width, heads) for _ in range(layers))
        self.policy = nn.Linear(width, POLICY_ACTIONS)
        self.value = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))
        nn.init.orthogonal_(self.policy.weight, 0.01)
        nn.init.zeros_(self.policy.bias)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        z, present = self.embed(x), x[..., 0] > 0
        for i, layer in enumerate(self.layers):
            z = layer(z, present, ego_only=i == len(self.layers) - 1)
        return self.policy(z[:, 0]), self.value(z[:, 0]).squeeze(-1)
