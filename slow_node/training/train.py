"""Train the intent parser: low-rank delta of MiniLM and the heads, on generated commands.

    python -m slow_node.training.train [--out FOLDER] [--size N] [--epochs N] [--seed N]

One thread, an hour: four epochs from nothing, then two warm restarts of an epoch each from what was written. Every
epoch has new commands; the same seed on the same machine gives the same weights, to the last bit.
5 % of the hand-written frames (not of the sentences made from them) are held out; on what is made of those the
temperatures of the heads are fitted, and the figures in the sidecar are measured.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save_file
from safetensors.torch import load_file
from tokenizers import Tokenizer
from torch import Tensor, nn
from torch.nn import functional

from slow_node.evaluation.score import exam_texts, plain_text
from slow_node.llm.embedding import DELTA, GRAM_SCALES, GRAMS, MAX_TOKENS, WEIGHTS_PACKAGE, in_bytes, package_file
from slow_node.training.generator import Generator
from slow_node.training.stock import Sample, Stock, load_stock
from slow_node.understanding.intent_parser import BUCKETS, HEADS, grams
from slow_node.understanding.numbers import in_digits

RANK, HIDDEN = 16, 96
SLICES = {name: len(classes) for name, classes in HEADS.items()}
TARGETS = (
    "attention.self.query",
    "attention.self.key",
    "attention.self.value",
    "attention.output.dense",
    "intermediate.dense",
    "output.dense",
)
BATCH = 48
LEARNING_RATE = 1.2e-3
RESTARTS = 2


class Encoder(nn.Module):
    """MiniLM with a trainable low-rank delta on every linear layer: y = x (W + B A)^T + b."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        config = json.loads((folder / "config.json").read_text())
        self.layers, self.heads, self.eps = (
            config["num_hidden_layers"],
            config["num_attention_heads"],
            config["layer_norm_eps"],
        )
        self.w: dict[str, Tensor] = load_file(folder / "model.safetensors")
        self.delta = nn.ParameterDict()
        for layer in range(self.layers):
            for target in TARGETS:
                name = f"encoder.layer.{layer}.{target}"
                out, width = self.w[f"{name}.weight"].shape
                self.delta[f"{name}.a".replace(".", "/")] = nn.Parameter(torch.randn(RANK, width) / math.sqrt(width))
                self.delta[f"{name}.b".replace(".", "/")] = nn.Parameter(torch.zeros(out, RANK))

    def _linear(self, x: Tensor, name: str) -> Tensor:
        key = name.replace(".", "/")
        y = functional.linear(x, self.w[f"{name}.weight"], self.w[f"{name}.bias"])
        return y + functional.linear(functional.linear(x, self.delta[f"{key}/a"]), self.delta[f"{key}/b"])

    def _norm(self, x: Tensor, name: str) -> Tensor:
        return functional.layer_norm(x, x.shape[-1:], self.w[f"{name}.weight"], self.w[f"{name}.bias"], self.eps)

    def forward(self, ids: Tensor, mask: Tensor) -> Tensor:
        """(B, T) token ids and their mask to (B, 768): mean and maximum over each sentence's tokens."""
        w = self.w
        x = (
            w["embeddings.word_embeddings.weight"][ids]
            + w["embeddings.position_embeddings.weight"][: ids.shape[1]]
            + w["embeddings.token_type_embeddings.weight"][0]
        )
        x = self._norm(x, "embeddings.LayerNorm")
        batch, tokens, width = x.shape
        for layer in range(self.layers):
            at = f"encoder.layer.{layer}"
            q, k, v = (
                self._linear(x, f"{at}.attention.self.{n}").view(batch, tokens, self.heads, -1).transpose(1, 2)
                for n in ("query", "key", "value")
            )
            y = functional.scaled_dot_product_attention(q, k, v, attn_mask=mask[:, None, None, :])
            y = y.transpose(1, 2).reshape(batch, tokens, width)
            x = self._norm(x + self._linear(y, f"{at}.attention.output.dense"), f"{at}.attention.output.LayerNorm")
            y = functional.gelu(self._linear(x, f"{at}.intermediate.dense"))
            x = self._norm(x + self._linear(y, f"{at}.output.dense"), f"{at}.output.LayerNorm")
        kept = mask[:, :, None]
        mean = (x * kept).sum(1) / kept.sum(1)
        return torch.cat([mean, x.masked_fill(~kept, -1e4).amax(1)], dim=1)


class Network(nn.Module):
    """Encoder, hashed n-grams, heads."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.encoder = Encoder(folder)
        self.dense = nn.Linear(768, sum(SLICES.values()))
        self.sparse = nn.Embedding(BUCKETS, HIDDEN)
        nn.init.normal_(self.sparse.weight, std=0.05)
        self.sparse_bias = nn.Parameter(torch.zeros(HIDDEN))
        self.top = nn.Linear(HIDDEN, sum(SLICES.values()), bias=False)

    def forward(self, ids: Tensor, mask: Tensor, buckets: Tensor, offsets: Tensor, keep: Tensor) -> dict[str, Tensor]:
        """Logits by head. `keep` (B, 2): 0 where a sentence's vector or its n-grams are dropped."""
        logits = self.dense(self.encoder(ids, mask)) * keep[:, :1] + self.spelling(buckets, offsets) * keep[:, 1:]
        return by_head(logits)

    def spelling(self, buckets: Tensor, offsets: Tensor) -> Tensor:
        """(B, classes): logits of the n-grams alone."""
        counts = torch.diff(offsets, append=torch.tensor([len(buckets)]))
        bag = functional.embedding_bag(buckets, self.sparse.weight, offsets, mode="sum") / counts.sqrt()[:, None]
        logits: Tensor = self.top(functional.dropout(functional.relu(bag + self.sparse_bias), 0.2, self.training))
        return logits


def by_head(logits: Tensor) -> dict[str, Tensor]:
    """(B, classes) split into the heads."""
    return dict(zip(SLICES, logits.split(list(SLICES.values()), dim=1), strict=True))


class Data:
    """Samples as tensors, in batches of sentences of like length."""

    def __init__(self, samples: list[Sample], tokenizer: Tokenizer | None) -> None:
        """Without a tokenizer: n-grams only. Texts of the labelled sets are left out."""
        exam = exam_texts()
        samples = [s for s in samples if plain_text(s.text) not in exam]
        self.samples = samples
        texts = [in_digits(s.text) for s in samples]
        self.ids = (
            [torch.tensor(e.ids) for e in tokenizer.encode_batch(texts)]
            if tokenizer
            else [torch.zeros(1, dtype=torch.long)] * len(texts)
        )
        self.grams = [torch.from_numpy(grams(text)) for text in texts]
        self.labels = torch.tensor([[HEADS[h].index(s.label[h]) for h in HEADS] for s in samples])

    def batches(
        self, r: random.Random | None, batch: int = BATCH
    ) -> Iterator[tuple[list[int], Tensor, Tensor, Tensor, Tensor, Tensor]]:
        """Indices, ids, mask, buckets, offsets, labels; shuffled by `r`."""
        order = list(range(len(self.samples)))
        if r:
            r.shuffle(order)
        order.sort(key=lambda i: len(self.ids[i]) + (r.random() * 3 if r else 0))
        chunks = [order[i : i + batch] for i in range(0, len(order), batch)]
        if r:
            r.shuffle(chunks)
        for chunk in chunks:
            ids = nn.utils.rnn.pad_sequence([self.ids[i] for i in chunk], batch_first=True)
            sizes = torch.tensor([len(self.ids[i]) for i in chunk])
            mask = torch.arange(ids.shape[1])[None] < sizes[:, None]
            lengths = torch.tensor([0, *(len(self.grams[i]) for i in chunk[:-1])])
            yield (chunk, ids, mask, torch.cat([self.grams[i] for i in chunk]), lengths.cumsum(0), self.labels[chunk])


def loss_of(logits: dict[str, Tensor], labels: Tensor) -> Tensor:
    """Cross-entropy summed over heads; slots count only where the command is a directive."""
    directive = labels[:, 0] == 0
    total = torch.zeros(())
    for column, (name, values) in enumerate(logits.items()):
        each = functional.cross_entropy(values, labels[:, column], reduction="none", label_smoothing=0.02)
        if name not in ("outcome", "language"):
            each = each * directive
        total = total + each.mean() * (0.3 if name == "language" else 1.0)
    return total


def split(stock: Stock) -> tuple[Stock, Stock]:
    """The stock without, and with only, the twentieth of its frames that is held out: always the same ones."""
    chosen = {id(f) for f in stock.frames if zlib.crc32(f.text.encode()) % 20 == 0}
    return (
        Stock([f for f in stock.frames if id(f) not in chosen], stock.words),
        Stock([f for f in stock.frames if id(f) in chosen], stock.words),
    )


def evaluate(network: Network, data: Data, dense: float = 1.0) -> tuple[dict[str, Tensor], Tensor]:
    """Logits by head and labels for a whole set."""
    network.eval()
    parts: dict[str, list[Tensor]] = {name: [] for name in HEADS}
    labels = []
    with torch.no_grad():
        for _, ids, mask, buckets, offsets, wanted in data.batches(None):
            logits = network(ids, mask, buckets, offsets, torch.tensor([[dense, 1.0]]).repeat(len(ids), 1))
            labels.append(wanted)
            for name, values in logits.items():
                parts[name].append(values)
    network.train()
    return {name: torch.cat(values) for name, values in parts.items()}, torch.cat(labels)


def exact(logits: dict[str, Tensor], labels: Tensor) -> float:
    """Share with the right outcome and, for directives, every slot right."""
    right = {n: v.argmax(1) == labels[:, c] for c, (n, v) in enumerate(logits.items())}
    slots = torch.stack([v for n, v in right.items() if n not in ("outcome", "language")]).all(0)
    return float((right["outcome"] & (slots | (labels[:, 0] != 0))).float().mean())


def temperatures(logits: dict[str, Tensor], labels: Tensor) -> dict[str, float]:
    """Each head's divisor of logits with the least log-loss on held-out data."""
    grid = [0.6 + 0.1 * i for i in range(25)]
    directive = labels[:, 0] == 0
    found = {}
    for column, (name, values) in enumerate(logits.items()):
        rows = slice(None) if name in ("outcome", "language") else directive
        losses = [float(functional.cross_entropy(values[rows] / t, labels[rows, column])) for t in grid]
        found[name] = grid[losses.index(min(losses))]
    return found


def learn_spelling(
    network: Network, data: Data, seed: int, epochs: int = 5, rate: float = 4e-3, batch: int = 256
) -> None:
    """The n-grams alone, on many more commands than the encoder has time for."""
    parts = [*network.sparse.parameters(), *network.top.parameters(), network.sparse_bias]
    optimiser = torch.optim.Adam(parts, lr=rate)
    r = random.Random(seed)
    for epoch in range(epochs):
        for group in optimiser.param_groups:
            group["lr"] = rate * (1 - epoch / epochs)
        for _, _, _, buckets, offsets, labels in data.batches(r, batch):
            loss = loss_of(by_head(network.spelling(buckets, offsets)), labels)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()


def restore(network: Network, folder: Path) -> None:
    """Read weights that `save` wrote."""
    tensors = load_file(folder / DELTA.name)
    with torch.no_grad():
        for key, value in network.encoder.delta.items():
            value.copy_(tensors[key.replace("/", ".")].float())
        network.dense.weight.copy_(tensors["dense.weight"].float())
        network.dense.bias.copy_(tensors["dense.bias"].float())
        network.top.weight.copy_(tensors["top.weight"].float())
        network.sparse.weight.copy_(tensors[GRAMS].float() * tensors[GRAM_SCALES].float())
        network.sparse_bias.copy_(tensors["sparse.bias"].float())


def learn(
    network: Network, stock: Stock, tokenizer: Tokenizer, size: int, epochs: int, seed: int, rate: float, check: Data
) -> None:
    """Encoder, n-grams and heads together, on new commands in every epoch; the rates fall along half a cosine."""
    # The n-grams know what they can know by now, and are dropped at times: they must not do the encoder's work.
    groups = [
        {"params": network.encoder.delta.parameters(), "weight_decay": 0.01},
        {"params": network.dense.parameters(), "weight_decay": 0.01},
        {
            "params": [*network.sparse.parameters(), *network.top.parameters(), network.sparse_bias],
            "weight_decay": 0.0,
            "lr": 3e-4,
        },
    ]
    optimiser = torch.optim.AdamW(groups, lr=rate)
    rates = [group["lr"] for group in optimiser.param_groups]
    r = random.Random(seed)
    began, commands = time.monotonic(), 0
    for epoch in range(epochs):
        data = Data(Generator(stock, seed + 1 + epoch).samples(size), tokenizer)
        steps = math.ceil(len(data.samples) / BATCH)
        for step, (_, ids, mask, buckets, offsets, labels) in enumerate(data.batches(r)):
            progress = (epoch + step / steps) / epochs
            warm = min(1.0, (commands / BATCH + 1) / 100) * 0.5 * (1 + math.cos(math.pi * progress))
            for group, full in zip(optimiser.param_groups, rates, strict=True):
                group["lr"] = full * warm
            drop = torch.rand(len(ids))
            keep = torch.stack([drop > 0.05, (drop < 0.05) | (drop > 0.45)], 1).float()
            loss = loss_of(network(ids, mask, buckets, offsets, keep), labels)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            commands += len(ids)
            if step % 50 == 49:
                speed = commands / (time.monotonic() - began)
                print(f"{step + 1}/{steps} loss {float(loss.detach()):.3f}, {speed:.0f}/s", file=sys.stderr)
        print(f"epoch {epoch + 1}: held-out exact {exact(*evaluate(network, check)):.3f}", file=sys.stderr)


def prepared(seed: int) -> tuple[Network, Stock, Tokenizer, Data]:
    """An untrained network, the frames to train it on, its tokenizer, and the held-out commands."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    weights = package_file(WEIGHTS_PACKAGE, "model/model.safetensors")
    if weights is None:
        raise SystemExit(f"{WEIGHTS_PACKAGE} is not installed")
    tokenizer = Tokenizer.from_file(str(weights.parent / "tokenizer.json"))
    tokenizer.no_padding()
    tokenizer.enable_truncation(MAX_TOKENS)
    kept, held = split(load_stock())
    check = Data(Generator(held, seed).samples(2000), tokenizer)
    return Network(weights.parent), kept, tokenizer, check


def train(out: Path, size: int, epochs: int, seed: int) -> None:
    """From nothing: n-grams alone, then everything. Writes weights and sidecar. `size`: commands an epoch."""
    network, stock, tokenizer, check = prepared(seed)
    learn_spelling(network, Data(Generator(stock, seed).samples(2 * size), None), seed)
    print(f"n-grams alone: held-out exact {exact(*evaluate(network, check, dense=0.0)):.3f}", file=sys.stderr)
    learn(network, stock, tokenizer, size, epochs, seed, LEARNING_RATE, check)
    save(network, out, check, {"seed": seed, "commands_an_epoch": size, "epochs": epochs})


def restart(out: Path, size: int, epochs: int, seed: int, number: int) -> None:
    """Warm restart 1, 2, ...: an epoch at half the rate, from the weights in `out`, on other commands.

    Written anew is the mean of the weights before and after, which is steadier than either.
    """
    other = seed + 100 * number
    network, stock, tokenizer, check = prepared(other)
    restore(network, out)
    before = [p.detach().clone() for p in network.parameters()]
    spelling = Data(Generator(stock, other).samples(2 * size), None)
    learn_spelling(network, spelling, other, epochs=2, rate=1e-3, batch=128)
    learn(network, stock, tokenizer, size, 1, other, LEARNING_RATE / 2, check)
    with torch.no_grad():
        for after, old in zip(network.parameters(), before, strict=True):
            after.lerp_(old, 0.5)
    save(network, out, check, {"seed": seed, "commands_an_epoch": size, "epochs": epochs + number})


def save(network: Network, out: Path, check: Data, settings: dict[str, int]) -> None:
    """Float16 weights, the n-grams in bytes, and a JSON sidecar. Temperatures are folded into the heads."""
    logits, labels = evaluate(network, check)
    scale = temperatures(logits, labels)
    figures = {"held_out": float(len(labels)), "held_out_exact": exact(logits, labels)}
    figures |= {
        f"accuracy_{name}": float((v.argmax(1) == labels[:, c]).float().mean())
        for c, (name, v) in enumerate(logits.items())
    }
    tensors = {key.replace("/", "."): value.detach().numpy() for key, value in network.encoder.delta.items()}
    divisor = torch.cat([torch.full((n,), scale[name]) for name, n in SLICES.items()])
    tensors["dense.weight"] = (network.dense.weight / divisor[:, None]).detach().numpy()
    tensors["dense.bias"] = (network.dense.bias / divisor).detach().numpy()
    tensors["top.weight"] = (network.top.weight / divisor[:, None]).detach().numpy()
    tensors["sparse.bias"] = network.sparse_bias.detach().numpy()
    out.mkdir(parents=True, exist_ok=True)
    halves = {k: np.ascontiguousarray(v, np.float16) for k, v in tensors.items()}
    grams, scales = in_bytes(network.sparse.weight.detach().numpy())
    save_file({**halves, GRAMS: grams, GRAM_SCALES: scales}, out / DELTA.name)
    sidecar = {
        "base": "all-MiniLM-L6-v2",
        "rank": RANK,
        "heads": HEADS,
        "buckets": BUCKETS,
        "settings": settings,
        "figures": figures,
    }
    (out / DELTA.name).with_suffix(".json").write_text(json.dumps(sidecar, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=DELTA.parent)
    parser.add_argument("--size", type=int, default=52_000)
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    train(options.out, options.size, options.epochs, options.seed)
    for number in range(1, RESTARTS + 1):
        restart(options.out, options.size, options.epochs, options.seed, number)


if __name__ == "__main__":
    main()
