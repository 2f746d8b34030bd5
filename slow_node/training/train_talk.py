"""Train the head that tells a sentence for the car from talk: `python -m slow_node.training.train_talk`.

Examples of talk are the expansions of `talk/*.txt` and whatever else is not about driving; examples of sentences for
the car are the phrases, dressed and composed as for the intent parser. Logistic regression on the intent parser's own
features, seed 0, one thread, some minutes. The labelled sets and their talk are left out.
"""

from __future__ import annotations

import os
import random
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from schemas.runtime.process import ConfigError
from slow_node.evaluation.chatter import talk
from slow_node.evaluation.score import exam_texts, plain_text
from slow_node.llm.embedding import load_embedder
from slow_node.training.generator import Generator
from slow_node.training.stock import LANGUAGES, Frame, load_stock
from slow_node.understanding.intent_parser import IntentParser
from slow_node.understanding.reading.addressed import HEAD
from slow_node.understanding.reading.lexicon import rows

TALK = Path(__file__).with_name("talk")
FOR_THE_CAR, ELSEWHERE, WORDINGS = 5000, 1000, 9
"""Sentences for the car and out of scope; wordings of every line of talk."""
STEPS, RATE, DECAY = 3000, 0.02, 1e-3


def examples(seed: int = 0) -> tuple[list[str], list[str]]:
    """Sentences for the car, and talk."""
    draw = random.Random(seed)
    generator = Generator(load_stock(), seed)
    left_out = exam_texts() | {plain_text(s) for half in ("develop", "measure") for s in _said(half)}
    samples = [s for s in generator.samples(30_000) if plain_text(s.text) not in left_out]
    draw.shuffle(samples)
    ours = [s.text for s in samples if s.label["outcome"] != "out_of_scope"][:FOR_THE_CAR]
    others = [s.text for s in samples if s.label["outcome"] == "out_of_scope"][:ELSEWHERE]
    for name, group in (("phrases", "says"), ("questions", "asks"), ("questions", "follows"), ("triggers", "waits")):
        ours += [command for row in rows(name, group) for command in row.fields["matches"]]
    for language in LANGUAGES:
        for line in (TALK / f"{language}.txt").read_text("utf-8").splitlines():
            for _ in range(WORDINGS):
                text = generator.plain(Frame(line, language, ()))
                text = text[0].upper() + text[1:] if draw.random() < 0.8 else text
                others.append(text if text[-1] in "?!." or draw.random() < 0.2 else text + ".")
    known = set(ours)
    return ours, [text for text in dict.fromkeys(others) if text not in known and plain_text(text) not in left_out]


def _said(half: str) -> list[str]:
    return [s for lists in talk(half).values() for s in lists["sentences"]]


def fit(x: NDArray[np.float32], y: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]:
    """Weights and bias of a logistic regression, by Adam on all examples at once, both classes of equal weight."""
    n, width = x.shape
    share = np.where(y > 0.5, 0.5 / max(y.sum(), 1), 0.5 / max(n - y.sum(), 1)).astype(np.float32)
    w, m, v = (np.zeros(width + 1, np.float32) for _ in range(3))
    one = np.concatenate([x, np.ones((n, 1), np.float32)], axis=1)
    for step in range(1, STEPS + 1):
        p = 1.0 / (1.0 + np.exp(-np.clip(one @ w, -30, 30)))
        gradient = one.T @ (share * (p - y)) + DECAY * np.append(w[:-1], 0.0).astype(np.float32)
        m = 0.9 * m + 0.1 * gradient
        v = 0.999 * v + 0.001 * gradient**2
        w = w - RATE * (m / (1 - 0.9**step)) / (np.sqrt(v / (1 - 0.999**step)) + 1e-8)
    return w[:-1], float(w[-1])


def main() -> None:
    from safetensors.numpy import save_file

    parser = IntentParser.load(load_embedder())
    if parser is None:
        raise ConfigError("MiniLM is not installed: run `make setup`")
    ours, others = examples()
    print(f"{len(ours)} sentences for the car, {len(others)} of talk", flush=True)
    x = np.stack([np.concatenate(parser.features(text)) for text in (*ours, *others)])
    y = np.array([1.0] * len(ours) + [0.0] * len(others), np.float32)
    mean, scale = x.mean(axis=0), x.std(axis=0) + 1e-4
    held = np.arange(len(y)) % 10 == 0
    weights, bias = fit(((x - mean) / scale)[~held], y[~held])
    right = (((x[held] - mean) / scale) @ weights + bias > 0.0) == (y[held] > 0.5)
    print(f"right on a tenth that was held out: {right.mean():.4f}")
    weights, bias = fit((x - mean) / scale, y)
    weights = weights / scale
    tensors = {"weight": weights.astype(np.float32), "bias": np.array([bias - mean @ weights], np.float32)}
    save_file(tensors, HEAD)
    print(f"{HEAD.name} written")


if __name__ == "__main__":
    main()
