"""The paper's attention network (Eq. 11-13) with a value head (Eq. 14). Axes: B batch, N rows, F features, D width."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from schemas.driving.features import FEATURES
from schemas.wire.messages import POLICY_ACTIONS


class Encoder(nn.Module):
    """z <- z + MHSA(norm z) + FFN(norm z): Eq. 12 with a pre-norm and a residual term, our departure, for stability."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.up = nn.Linear(width, 2 * width)
        self.down = nn.Linear(2 * width, width)

    def forward(self, z: Tensor, present: Tensor) -> Tensor:
        """(B, N, D) -> (B, N, D); present (B, N): which rows may be attended to."""
        b, n, d = z.shape
        u = self.norm(z)
        q, k, v = (a.view(b, n, self.heads, d // self.heads).transpose(1, 2) for a in self.qkv(u).chunk(3, -1))
        attended = nn.functional.scaled_dot_product_attention(q, k, v, attn_mask=present[:, None, None, :])
        return torch.as_tensor(z + self.out(attended.transpose(1, 2).reshape(b, n, d)) + self._ffn(u))

    def ego(self, z: Tensor, present: Tensor) -> Tensor:
        """(B, N, D) -> (B, D): row 0 of `forward`, exactly, at a fraction of its cost.

        With one query, q . (K u_n) = (K^T q) . u_n, and sum_n w_n (V u_n) = V (sum_n w_n u_n): neither keys nor values
        of the other rows are needed. The keys' bias adds the same to every score, which softmax does not see.
        """
        d, h = z.shape[-1], self.heads
        u = self.norm(z)
        (query, key, value), (q_bias, _, v_bias) = self.qkv.weight.view(3, h, d // h, d), self.qkv.bias.view(3, h, -1)
        q = torch.einsum("bd,hkd->bhk", u[:, 0], query) + q_bias
        scores = torch.einsum("bhk,hkd->bhd", q, key) @ u.transpose(1, 2) / math.sqrt(d // h)
        weights = scores.masked_fill(~present[:, None], -1e9).softmax(-1)
        attended = torch.einsum("bhd,hkd->bhk", weights @ u, value) + v_bias
        return torch.as_tensor(z[:, 0] + self.out(attended.flatten(1)) + self._ffn(u[:, 0]))

    def _ffn(self, u: Tensor) -> Tensor:
        return torch.as_tensor(self.down(torch.relu(self.up(u))))


class ActorCritic(nn.Module):
    """(B, N, F) -> logits (B, 5), value (B,). Only `policy`, `embed` and `layers` are exported."""

    def __init__(self, width: int = 128, heads: int = 2, layers: int = 1) -> None:
        super().__init__()
        self.heads = heads
        self.embed = nn.Linear(len(FEATURES), width)
        self.layers = nn.ModuleList(Encoder(width, heads) for _ in range(layers))
        self.policy = nn.Linear(width, POLICY_ACTIONS)
        self.value = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))
        nn.init.orthogonal_(self.policy.weight, 0.01)
        nn.init.zeros_(self.policy.bias)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        z, present = self.embed(x), x[..., 0] > 0  # Eq. 11
        for layer in self.layers[:-1]:
            z = layer(z, present)  # Eq. 12
        last = self.layers[-1]
        assert isinstance(last, Encoder)
        ego = last.ego(z, present)
        return self.policy(ego), self.value(ego).squeeze(-1)  # Eq. 13, before its softmax, and Eq. 14
