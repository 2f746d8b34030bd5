"""Fine-tune the embedded language model: a low-rank delta of SmolLM2 (LoRA, Hu et al. 2021) from generated commands.

    python -m slow_node.training.fine_tune [--out FILE] [--size N] [--seed N]

One thread, an hour and a half: a pass over new commands, and another over others at half the rate. The weights are
those of the package, taken out of their four bits; what is written is the adapter that llama.cpp loads beside them.
The model learns to answer `prompt.adapted_prompt` with the JSON of the slots that were asked for, without their
numbers, which rules read better. Needs `gguf` (extra `train`). The network is our own because what turns an adapter of
transformers and peft into llama.cpp's is a script that no package has.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gguf
import numpy as np
import torch
from tokenizers import Tokenizer
from tokenizers.decoders import ByteLevel as Bytes
from tokenizers.models import BPE
from tokenizers.pre_tokenizers import ByteLevel, Digits
from tokenizers.pre_tokenizers import Sequence as Both
from torch import Tensor, nn
from torch.nn import functional

from slow_node.evaluation.score import exam_texts, plain_text
from slow_node.llm.embedded import ADAPTER, weights_path
from slow_node.planning.prompt import adapted_prompt
from slow_node.training.generate import slots_of
from slow_node.training.generator import Generator
from slow_node.training.stock import Sample, load_stock
from slow_node.training.train import split

RANK, ALPHA = 16, 32.0
TARGETS = ("attn_q", "attn_k", "attn_v", "attn_output", "ffn_gate", "ffn_up", "ffn_down")
BATCH, LEARNING_RATE, WARM_UP = 24, 1e-3, 40
START, END = "<|im_start|>", "<|im_end|>"


def metadata(reader: gguf.GGUFReader, key: str) -> Any:
    """A value from the head of a GGUF file."""
    return reader.fields[key].contents()


def tokenizer_of(reader: gguf.GGUFReader) -> Tokenizer:
    """The byte-level BPE tokenizer that the file describes (llama.cpp's "smollm": every digit by itself)."""
    tokens, merges = metadata(reader, "tokenizer.ggml.tokens"), metadata(reader, "tokenizer.ggml.merges")
    tokenizer = Tokenizer(BPE({t: i for i, t in enumerate(tokens)}, [tuple(m.split(" ", 1)) for m in merges]))
    tokenizer.pre_tokenizer = Both([Digits(individual_digits=True), ByteLevel(add_prefix_space=False)])
    tokenizer.decoder = Bytes()
    tokenizer.add_special_tokens([START, END])
    return tokenizer


class Llama(nn.Module):
    """SmolLM2 as llama.cpp computes it, in bfloat16, with a trainable delta on every linear layer of its blocks:
    y = x (W + alpha / rank B A)^T."""

    def __init__(self, reader: gguf.GGUFReader) -> None:
        super().__init__()

        def number(name: str) -> Any:
            return metadata(reader, f"llama.{name}")

        self.layers, self.eps = number("block_count"), number("attention.layer_norm_rms_epsilon")
        self.w = {
            t.name: torch.from_numpy(np.array(gguf.quants.dequantize(t.data, t.tensor_type), np.float32))
            for t in reader.tensors
        }
        width = number("rope.dimension_count")
        self.turns = number("rope.freq_base") ** (-torch.arange(0, width, 2) / width)
        self.delta = nn.ParameterDict()
        for name, weight in self.w.items():
            if weight.ndim == 2:
                self.w[name] = weight.bfloat16()
            if name.split(".")[-2] in TARGETS:
                out, into = weight.shape
                key = name.replace(".", "/")
                self.delta[f"{key}/a"] = nn.Parameter(torch.randn(RANK, into) / math.sqrt(into))
                self.delta[f"{key}/b"] = nn.Parameter(torch.zeros(out, RANK))

    def _linear(self, x: Tensor, name: str) -> Tensor:
        key = f"{name}.weight".replace(".", "/")
        low = functional.linear(x, self.delta[f"{key}/a"].bfloat16())
        return functional.linear(x, self.w[f"{name}.weight"]) + functional.linear(
            low, (ALPHA / RANK * self.delta[f"{key}/b"]).bfloat16()
        )

    def _norm(self, x: Tensor, name: str) -> Tensor:
        return functional.rms_norm(x, x.shape[-1:], self.w[f"{name}.weight"], self.eps).bfloat16()

    def _turned(self, x: Tensor) -> Tensor:
        """Rotary positions on neighbouring pairs, as the file's rows are ordered for."""
        angle = torch.arange(x.shape[2])[:, None] * self.turns
        one, other = x.float().unflatten(-1, (-1, 2)).unbind(-1)
        turned = (one * angle.cos() - other * angle.sin(), one * angle.sin() + other * angle.cos())
        return torch.stack(turned, -1).flatten(-2).bfloat16()

    def forward(self, ids: Tensor, wanted: Tensor) -> Tensor:
        """(B, T) ids, filled up at the end, and where (B, T) a token is to be told; (N, vocabulary) logits there."""
        w = self.w
        x = w["token_embd.weight"][ids].float()
        batch, tokens, _ = x.shape
        for layer in range(self.layers):
            at = f"blk.{layer}"
            y = self._norm(x, f"{at}.attn_norm")
            q, k, v = (
                self._linear(y, f"{at}.attn_{n}").view(batch, tokens, -1, 2 * len(self.turns)).transpose(1, 2)
                for n in "qkv"
            )
            y = functional.scaled_dot_product_attention(
                self._turned(q), self._turned(k), v, is_causal=True, enable_gqa=True
            )
            x = x + self._linear(y.transpose(1, 2).reshape(batch, tokens, -1), f"{at}.attn_output")
            y = self._norm(x, f"{at}.ffn_norm")
            gate = functional.silu(self._linear(y, f"{at}.ffn_gate"))
            x = x + self._linear(gate * self._linear(y, f"{at}.ffn_up"), f"{at}.ffn_down")
        y = self._norm(x[wanted], "output_norm")
        return functional.linear(y, w.get("output.weight", w["token_embd.weight"])).float()


def answer_of(label: dict[str, str]) -> str:
    """What the model is to say: the slots that were asked for, without numbers."""
    return slots_of(label).compact()


def rendered(text: str) -> str:
    """The chat as SmolLM2's template writes it, up to where the answer begins."""
    turns = "".join(f"{START}{turn['role']}\n{turn['content']}{END}\n" for turn in adapted_prompt(text))
    return f"{turns}{START}assistant\n"


def batches(samples: list[Sample], tokenizer: Tokenizer, r: random.Random) -> Iterator[tuple[Tensor, Tensor]]:
    """(B, T) ids and where the answers are, of chats of like length, in random order."""
    prompts = tokenizer.encode_batch([rendered(s.text) for s in samples], add_special_tokens=False)
    answers = tokenizer.encode_batch([answer_of(s.label) + END for s in samples], add_special_tokens=False)
    chats = sorted(((p.ids, a.ids) for p, a in zip(prompts, answers, strict=True)), key=lambda c: len(c[0]) + len(c[1]))
    chunks = [chats[i : i + BATCH] for i in range(0, len(chats), BATCH)]
    r.shuffle(chunks)
    for chunk in chunks:
        ids = nn.utils.rnn.pad_sequence([torch.tensor(p + a) for p, a in chunk], batch_first=True)
        place = torch.arange(ids.shape[1])
        first = torch.tensor([len(p) for p, _ in chunk])[:, None]
        last = torch.tensor([len(p) + len(a) for p, a in chunk])[:, None]
        yield ids, (place >= first) & (place < last)


def loss_of(model: Llama, ids: Tensor, answer: Tensor) -> Tensor:
    """Cross-entropy of the answers' tokens, each from those before it."""
    return functional.cross_entropy(model(ids[:, :-1], answer[:, 1:]), ids[:, 1:][answer[:, 1:]])


def save(model: Llama, out: Path) -> None:
    """The delta as llama.cpp reads it, in float16."""
    out.parent.mkdir(parents=True, exist_ok=True)
    writer = gguf.GGUFWriter(out, "llama")
    writer.add_type("adapter")
    writer.add_string("adapter.type", "lora")
    writer.add_float32("adapter.lora.alpha", ALPHA)
    for key, value in model.delta.items():
        name, _, part = key.replace("/", ".").rpartition(".")
        writer.add_tensor(f"{name}.lora_{part}", value.detach().numpy().astype(np.float16))
    writer.write_header_to_file()
    writer.write_kv_data_to_file()
    writer.write_tensors_to_file()
    writer.close()


def restore(model: Llama, path: Path) -> None:
    """Read what `save` wrote."""
    with torch.no_grad():
        for tensor in gguf.GGUFReader(path).tensors:
            name, _, part = tensor.name.rpartition(".lora_")
            model.delta[f"{name}/{part}".replace(".", "/")].copy_(torch.from_numpy(np.array(tensor.data, np.float32)))


def train(out: Path, size: int, seed: int, before: Path | None = None) -> None:
    """One pass over `size` generated commands; writes the adapter and prints the loss as it goes.

    before: go on from this adapter, at half the rate.
    """
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    r = random.Random(seed)
    reader = gguf.GGUFReader(weights_path())
    model, tokenizer = Llama(reader), tokenizer_of(reader)
    if before:
        restore(model, before)
    exam = exam_texts()
    stock, held = split(load_stock())
    samples = [s for s in Generator(stock, seed).samples(3 * size) if plain_text(s.text) not in exam]
    samples = r.sample(samples, min(size, len(samples)))
    check = list(batches(Generator(held, seed).samples(1000)[:240], tokenizer, r))
    highest = LEARNING_RATE * (0.5 if before else 1.0)
    optimiser = torch.optim.AdamW(model.delta.parameters(), lr=highest, weight_decay=0.01)
    steps, began, losses = math.ceil(len(samples) / BATCH), time.monotonic(), []
    for step, (ids, answer) in enumerate(batches(samples, tokenizer, r), 1):
        rate = highest * min(1.0, step / WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / steps))
        for group in optimiser.param_groups:
            group["lr"] = rate
        loss = loss_of(model, ids, answer)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(model.delta.parameters(), 1.0)
        optimiser.step()
        losses.append(float(loss.detach()))
        if step % 10 == 0 or step == steps:
            left = (time.monotonic() - began) / step * (steps - step) / 60
            recent = sum(losses[-10:]) / 10
            print(f"{step}/{steps} loss {recent:.3f}, {left:.0f} min left", file=sys.stderr, flush=True)
        if step % 200 == 0 or step == steps:
            with torch.no_grad():
                held_out = sum(float(loss_of(model, *pair)) for pair in check) / len(check)
            print(f"held-out loss {held_out:.3f}", file=sys.stderr, flush=True)
            save(model, out)
    out.with_suffix(".json").write_text(
        json.dumps(
            {
                "base": weights_path().name,
                "rank": RANK,
                "alpha": ALPHA,
                "commands": len(samples),
                "seed": seed,
                "second_pass": before is not None,
                "held_out_loss": round(held_out, 4),
            },
            indent=1,
        )
        + "\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ADAPTER)
    parser.add_argument(
        "--size", type=int, default=13_000, help="commands of the first pass; the second has two thirds of that"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    train(options.out, options.size, options.seed)
    train(options.out, 2 * options.size // 3, options.seed + 1, options.out)


if __name__ == "__main__":
    main()
