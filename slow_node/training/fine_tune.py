"""Fine-tune the embedded language model, SmolLM2, from pairs of P_t and program: LoRA (Hu et al. 2021).

    python -m slow_node.training.programs --seed 1 --size 9000 > runs/pairs.jsonl
    python -m slow_node.training.programs --held-out --seed 7 --size 600 > runs/held.jsonl
    python -m slow_node.training.fine_tune --pairs runs/pairs.jsonl --held runs/held.jsonl --out runs/adapter.gguf

One thread; some three pairs in a second of a core's time. Stopped at any moment, the same command goes on from its
last checkpoint (`OUT.checkpoint`). The weights are those of the package, taken out of their four bits; what is written
is the adapter that llama.cpp loads beside them. It begins with the adapter that is shipped. Needs `gguf` (extra
`train`). The network is our own because what turns an adapter of transformers and peft into llama.cpp's is a script
that no package has.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
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

from slow_node.llm.adapter import ADAPTER
from slow_node.llm.dialect import Chat
from slow_node.llm.embedded import weights_path

RANK, ALPHA = 16, 32.0
TARGETS = ("attn_q", "attn_k", "attn_v", "attn_output", "ffn_gate", "ffn_up", "ffn_down")
BATCH, LEARNING_RATE, WARM_UP = 16, 7e-4, 15
SORTED = 16
"""So many batches are made of like lengths together."""
CHECKED = 96
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


def rendered(chat: Chat) -> str:
    """A chat as SmolLM2's template writes it, up to where the answer begins."""
    turns = "".join(f"{START}{turn['role']}\n{turn['content']}{END}\n" for turn in chat)
    return f"{turns}{START}assistant\n"


def read_pairs(path: Path, size: int | None = None) -> list[tuple[Chat, str]]:
    """The chats and answers of a file of `slow_node.training.programs`."""
    with path.open(encoding="utf-8") as file:
        rows = (json.loads(line) for line in islice(file, size))
        return [(row["chat"], row["answer"]) for row in rows]


def batches(
    pairs: list[tuple[Chat, str]], tokenizer: Tokenizer, seed: int, skip: int = 0
) -> Iterator[tuple[Tensor, Tensor]]:
    """(B, T) ids and where the answers are, of chats of like length; without the first `skip` batches."""
    for number, begin in enumerate(range(0, len(pairs), BATCH * SORTED)):
        part = pairs[begin : begin + BATCH * SORTED]
        first = number * SORTED
        if first + math.ceil(len(part) / BATCH) <= skip:
            continue
        prompts = tokenizer.encode_batch([rendered(chat) for chat, _ in part], add_special_tokens=False)
        answers = tokenizer.encode_batch([answer + END for _, answer in part], add_special_tokens=False)
        chats = sorted(
            ((p.ids, a.ids) for p, a in zip(prompts, answers, strict=True)), key=lambda c: len(c[0]) + len(c[1])
        )
        chunks = [chats[i : i + BATCH] for i in range(0, len(chats), BATCH)]
        random.Random(seed + number).shuffle(chunks)
        for chunk in chunks[max(skip - first, 0) :]:
            ids = nn.utils.rnn.pad_sequence([torch.tensor(p + a) for p, a in chunk], batch_first=True)
            place = torch.arange(ids.shape[1])
            begins = torch.tensor([len(p) for p, _ in chunk])[:, None]
            ends = torch.tensor([len(p) + len(a) for p, a in chunk])[:, None]
            yield ids, (place >= begins) & (place < ends)


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


@dataclass
class Run:
    """A training that can be stopped at any moment and gone on with."""

    model: Llama
    optimiser: torch.optim.AdamW
    path: Path
    """Of the checkpoint."""
    step: int = 0

    def save(self) -> None:
        state = {"step": self.step, "delta": self.model.delta.state_dict(), "optimiser": self.optimiser.state_dict()}
        torch.save(state, self.path.with_suffix(".part"))
        self.path.with_suffix(".part").replace(self.path)

    def resume(self) -> None:
        if self.path.exists():
            state = torch.load(self.path)
            self.model.delta.load_state_dict(state["delta"])
            self.optimiser.load_state_dict(state["optimiser"])
            self.step = state["step"]


def rate_at(step: int, steps: int) -> float:
    """Of the highest: up at the beginning, down over the last third."""
    return min(1.0, step / WARM_UP, max(3.0 * (steps - step) / steps, 0.02))


def train(pairs_path: Path, held_path: Path, out: Path, seed: int, before: Path | None, size: int | None) -> None:
    """One pass over the pairs; writes the adapter and prints the loss as it goes."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    reader = gguf.GGUFReader(weights_path())
    model, tokenizer = Llama(reader), tokenizer_of(reader)
    if before:
        restore(model, before)
    out.parent.mkdir(parents=True, exist_ok=True)
    optimiser = torch.optim.AdamW(model.delta.parameters(), lr=LEARNING_RATE, weight_decay=0.01)
    run = Run(model, optimiser, out.with_suffix(".checkpoint"))
    run.resume()
    pairs = read_pairs(pairs_path, size)
    check = list(batches(read_pairs(held_path, CHECKED), tokenizer, seed))
    steps, began, first, losses, held_out = math.ceil(len(pairs) / BATCH), time.monotonic(), run.step, [], math.nan
    for ids, answer in batches(pairs, tokenizer, seed, run.step):
        run.step += 1
        for group in optimiser.param_groups:
            group["lr"] = LEARNING_RATE * rate_at(run.step, steps)
        loss = loss_of(model, ids, answer)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(model.delta.parameters(), 1.0)
        optimiser.step()
        losses.append(float(loss.detach()))
        if run.step % 10 == 0 or run.step == steps:
            left = (time.monotonic() - began) / (run.step - first) * (steps - run.step) / 60
            recent = sum(losses[-10:]) / len(losses[-10:])
            print(f"{run.step}/{steps} loss {recent:.3f}, {left:.0f} min left", file=sys.stderr, flush=True)
            run.save()
        if run.step % 60 == 0 or run.step == steps:
            with torch.no_grad():
                held_out = sum(float(loss_of(model, *pair)) for pair in check) / len(check)
            print(f"held-out loss {held_out:.3f}", file=sys.stderr, flush=True)
            save(model, out)
            about = {"base": weights_path().name, "answers": "programs", "rank": RANK, "alpha": ALPHA, "seed": seed}
            about |= {"pairs": run.step * BATCH, "of": len(pairs), "held_out_loss": round(held_out, 4)}
            out.with_suffix(".json").write_text(json.dumps(about, indent=1) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=Path, required=True, help="what to train on")
    parser.add_argument("--held", type=Path, required=True, help="what to tell the held-out loss by")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--before", type=Path, default=ADAPTER, help="the adapter to begin with")
    parser.add_argument("--size", type=int, default=None, help="of the pairs, the first so many only")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    train(options.pairs, options.held, options.out, options.seed, options.before, options.size)


if __name__ == "__main__":
    main()
