"""Training commands: phrases written by hand (`phrases/*.txt`), composed by a seeded generator.

    python -m slow_node.training.generate --seed 0 --size 24000 > commands.jsonl

Each line is labelled as the exams are, with a scene, for training or trying any other model: {"id", "text", "language",
"scene", "outcome", "slots"}; `fastslow interpret --input commands.jsonl` reads it.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
from collections import defaultdict
from collections.abc import Iterator

from slow_node.evaluation.score import exam_texts, plain_text
from slow_node.training.generator import Generator
from slow_node.training.stock import LIMIT_MPS, Frame, Label, Sample, Stock, load_stock
from slow_node.understanding.intent_parser import HEADS, with_numbers
from slow_node.understanding.numbers import quantities
from slow_node.understanding.slots import Slots


def slots_of(label: Label) -> Slots:
    """What a label asks for, but for its numbers, which the text has."""
    asked = {k: v for k, v in label.items() if k not in ("number", "language") and (k == "outcome" or v != HEADS[k][0])}
    return Slots.model_validate({k: v == "true" if k in ("overtake", "cancel") else v for k, v in asked.items()})


def in_scenes(samples: list[Sample], seed: int) -> Iterator[dict[str, object]]:
    """Labelled commands, each in a scene of its own: speed and traffic are drawn, numbers are resolved against them.

    The road stays the one that the phrases are labelled for: four lanes, the ego in the second, limit `LIMIT_MPS`.
    """
    r = random.Random(seed)
    for number, sample in enumerate(samples, 1):
        speed = round(r.uniform(15.0, LIMIT_MPS), 1)
        vehicles = [
            {"lane": 1, "gap_m": round(r.uniform(12.0, 80.0), 1), "speed_mps": round(r.uniform(0.6, 1.0) * speed, 1)}
        ]
        vehicles += [
            {
                "lane": r.choice((0, 2, 3)),
                "gap_m": round(r.choice((-1.0, 1.0)) * r.uniform(5.0, 100.0), 1),
                "speed_mps": round(r.uniform(0.7, 1.2) * speed, 1),
            }
            for _ in range(r.randrange(5))
        ]
        slots = with_numbers(slots_of(sample.label), sample.label["number"], quantities(sample.text), speed, LIMIT_MPS)
        yield {
            "id": f"g{number}",
            "text": sample.text,
            "language": sample.language,
            "scene": {"lanes": 4, "ego_lane": 1, "speed_mps": speed, "limit_mps": LIMIT_MPS, "vehicles": vehicles},
            "outcome": slots.outcome,
            "slots": slots.labelled(LIMIT_MPS),
        }


def examples(stock: Stock, seed: int) -> Iterator[dict[str, object]]:
    """Examples for the memory bank: some English phrases of every label, one of the main labels elsewhere."""
    exam = exam_texts()
    stock = Stock([frame for frame in stock.frames if plain_text(frame.text) not in exam], stock.words)
    generator = Generator(stock, seed)
    r = random.Random(seed)
    groups: dict[tuple[str, tuple[tuple[str, str], ...]], list[Frame]] = defaultdict(list)
    for frame in stock.frames:
        groups[frame.language, frame.label].append(frame)
    for (language, label), frames in groups.items():
        if language == "other" or (language != "en" and "number" in dict(label)):
            continue
        plain = 3 if language == "en" else 1  # the first of a section are the plainest
        others = 0 if language != "en" or "number" in dict(label) else min(len(frames) // 20, 8)
        for frame in [*frames[:plain], *r.sample(frames[plain:], min(others, len(frames[plain:])))]:
            text = generator.plain(frame)
            known = dict(label)
            slots = with_numbers(slots_of(known), known.get("number", "none"), quantities(text), 25, 33)
            heard = [f"{k} {v}" for k, v in slots.model_dump(exclude_defaults=True, exclude={"outcome"}).items()]
            reason = {
                "refused": "dangerous or against the rules",
                "out_of_scope": "not about how the car drives",
                "unclear": "cannot be told: ask",
            }.get(slots.outcome, "wants " + ", ".join(heard))
            if slots.outcome == "directive" and slots.is_empty():
                continue
            yield {
                "command": text[:1].upper() + text[1:],
                "scene": "one-way road; slow car ahead",
                "slots": json.loads(slots.model_copy(update={"reasoning": reason[:80]}).compact()),
            }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", type=int, default=24_000)
    parser.add_argument("--examples", action="store_true", help="write the memory bank's examples.jsonl instead")
    options = parser.parse_args()
    if options.examples:
        for row in examples(load_stock(), options.seed):
            sys.stdout.write(json.dumps(row, ensure_ascii=False) + "\n")
        return
    for row in in_scenes(Generator(load_stock(), options.seed).samples(options.size), options.seed):
        sys.stdout.write(json.dumps(row, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
