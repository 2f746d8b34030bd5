"""Training pairs for the embedded model: what it is asked (`prompt.Asked`) and the program that it should answer.

    python -m slow_node.training.programs --seed 0 --size 1000 > pairs.jsonl

Commands are those of the slots' generator, with programs from their labels, and compositions of `programs.toml`:
values, lanes by number, triggers, order, follow-ups, questions, chatter. Each has a scene of its own, often turns
before it, a recalled example, and the quick reader's reading: as it is, or wrong as readers are wrong, or none. The
same seed gives the same pairs.
"""

from __future__ import annotations

import argparse
import random
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

from schemas.driving.measures import CAR_LENGTH_M
from schemas.wire.messages import Lane, Observation
from schemas.wire.program import Act, Program, Side, Step, Trigger
from schemas.wire.text import json_line
from slow_node.evaluation.score import exam_texts, plain_text
from slow_node.llm.embedding import load_embedder
from slow_node.memory.bank import Memory
from slow_node.planning.program_text import brief, same, written
from slow_node.planning.prompt import Asked, program_prompt
from slow_node.planning.scene import Scene, encode_scene, in_brief
from slow_node.training.generate import slots_of
from slow_node.training.generator import Generator
from slow_node.training.stock import LANGUAGES, LIMIT_MPS, Sample, Stock, load_stock
from slow_node.understanding.intent_parser import IntentParser, with_numbers
from slow_node.understanding.numbers import quantities
from slow_node.understanding.reading.lexicon import rows, searchable
from slow_node.understanding.reading.reader import ProgramReader
from slow_node.understanding.reading.values import corrected, steps_of

TEMPLATES = Path(__file__).with_name("programs.toml")
FROM_MEMORY_COSINE = 0.6
HELD = ("rear gap in lane", "front gap in lane", "oncoming traffic", "no gap to return to", "lead too close")
_FLIPPED: dict[Act, Act] = {
    "faster": "slower", "slower": "faster", "closer": "farther", "farther": "closer", "overtake": "cancel",
    "more": "less", "again": "back", "yield": "overtake", "stop": "slower", "keep": "cancel", "drive": "faster",
}  # fmt: skip
_SIDES: dict[Side, Side] = {
    "left": "right",
    "right": "left",
    "leftmost": "left",
    "rightmost": "right",
    "either": "left",
}


@dataclass(frozen=True)
class Pair:
    """One example: what is asked, and the answer."""

    asked: Asked
    answer: Program
    kind: str
    language: str

    @property
    def text(self) -> str:
        return written(self.answer)


def random_scene(r: random.Random) -> Scene:
    """A road with traffic: mostly four lanes and the ego in the second, as the phrases are labelled for."""
    two_way = r.random() < 0.2
    count = 2 if two_way else r.choice((2, 3, 4, 4, 4))
    ego = 1 if two_way else min(r.choice((0, 1, 1, 2, 3)), count - 1)
    limit = r.choice((8.0, 20.0, 25.0, LIMIT_MPS, LIMIT_MPS))
    speed = r.uniform(0.5, 1.0) * limit
    found = [(0, 0.0, 4.0 * ego, speed, 0, 0, CAR_LENGTH_M, 2, ego)]
    if r.random() < 0.8:
        found.append((1, r.uniform(12, 90) + CAR_LENGTH_M, 4.0 * ego, r.uniform(0.6, 1.0) * speed, 0, 0, 5, 2, ego))
    for number in range(r.randrange(5)):
        lane = r.randrange(count)
        oncoming = two_way and lane == 0
        x = r.uniform(20, 140) if oncoming else r.choice((-1, 1)) * r.uniform(6, 100)
        if lane != ego:
            pace = (-1 if oncoming else 1) * r.uniform(0.7, 1.2) * speed
            found.append((number + 2, x, 4.0 * lane, pace, 0, 0, 5, 2, lane))
    lanes = tuple(
        Lane(y_m=4.0 * i, start_m=-1e4, end_m=1e4, direction=-1 if two_way and i == 0 else 1, speed_limit_mps=limit)
        for i in range(count)
    )
    data = np.array(found, np.float32).tobytes()
    return encode_scene(Observation(epoch=0, stamp_ns=0, tick=0, scenario="", lanes=lanes, rows=data, target_lane=ego))


class Programs:
    """Draws pairs. Needs the intent parser for the reader's readings, and the memory bank's examples."""

    def __init__(self, stock: Stock, seed: int, reader: ProgramReader | None, memory: Memory | None) -> None:
        self._r = random.Random(seed)
        self._reader, self._memory = reader, memory
        self._samples = self._endless(stock, seed)
        self._templates: dict[str, Any] = tomllib.loads(TEMPLATES.read_text("utf-8"))
        self._words: dict[str, dict[str, list[str]]] = self._templates["words"]
        self._plain: dict[str, list[tuple[str, Program]]] = {language: [] for language in LANGUAGES}
        self._recent: list[Program] = [Program(outcome="directive", steps=(Step(act="faster"),))]

    def _endless(self, stock: Stock, seed: int) -> Iterator[Sample]:
        while True:
            found = Generator(stock, seed).samples(len(stock.frames) + 6000)
            self._r.shuffle(found)
            yield from found
            seed += 1

    def pairs(self) -> Iterator[Pair]:
        """Without end; none is a command of a labelled set."""
        exam = exam_texts()
        kinds: dict[Callable[[Scene], tuple[str, Program, str] | None], int] = {
            self._slotted: 46, self._said: 14, self._timed: 12, self._ordered: 6, self._followed: 5, self._asked_for: 4,
        }  # fmt: skip
        while True:
            scene = random_scene(self._r)
            kind = self._r.choices(list(kinds), list(kinds.values()))[0]
            made = kind(scene)
            if made is None or not 0 < len(made[0]) <= 250 or plain_text(made[0]) in exam:
                continue
            text, program, language = made
            name = kind.__name__.strip("_")
            if self._r.random() < (0.12 if name == "slotted" else 0.25) and program.outcome == "directive":
                text, name = self._chattered(text, language), "chattered"
            yield self._pair(text, program, language, name, scene)

    def _pair(self, text: str, program: Program, language: str, kind: str, scene: Scene) -> Pair:
        r = self._r
        asked = Asked(text, in_brief(scene) if r.random() < 0.9 else "")
        hint = self._hinted(text, program, scene)
        if hint is not None:
            asked = replace(asked, hint=hint[0], confidence=hint[1])
        if kind == "followed" or r.random() < 0.25:
            asked = replace(asked, turns=tuple(brief(r.choice(self._recent)) for _ in range(r.choice((1, 1, 2)))))
        if r.random() < 0.12:
            asked = replace(asked, wishes=brief(r.choice(self._recent)))
        if program.outcome == "directive" and r.random() < 0.06:
            asked = replace(
                asked, held=f"held up by {r.choice(HELD)}", hint=program, confidence=1.0, wishes=brief(program)
            )
        if self._memory is not None and r.random() < 0.4:
            near = [e for e in self._memory.nearest(text, 2) if plain_text(e.command) != plain_text(text)]
            if near and near[0].cosine >= FROM_MEMORY_COSINE:
                asked = replace(asked, memory=near[0])
        if program.outcome == "directive":
            self._recent = [*self._recent[-40:], program]
        return Pair(asked, program, kind, language)

    def _hinted(self, text: str, program: Program, scene: Scene) -> tuple[Program, float] | None:
        """The reader's reading; one that is wrong; or none."""
        drawn = self._r.random()
        if drawn < 0.3:
            return None
        if drawn < 0.5:
            wrong = self._wrong(program)
            if not same(wrong, program):
                return wrong, round(self._r.betavariate(2.0, 2.0), 2)
        if self._reader is None:
            return program, round(self._r.betavariate(6.0, 1.5), 2)
        reading = self._reader.read(text, scene.speed_mps, scene.limit_mps)
        return reading.program, 1.0 if reading.sure else reading.confidence

    def _wrong(self, program: Program) -> Program:
        """As readers are wrong: one thing missed, or the other way round, or another outcome."""
        r = self._r
        if not program.steps or r.random() < 0.25:
            other = r.choice(self._recent)
            return other if program.outcome != "directive" else Program(outcome=r.choice(("unclear", "out_of_scope")))
        at = r.randrange(len(program.steps))
        step, rest = program.steps[at], (*program.steps[:at], *program.steps[at + 1 :])
        if rest and r.random() < 0.5:
            return structs.replace(program, steps=rest)
        if step.when is not None or step.until is not None:
            changed = structs.replace(step, when=None, until=None)
        elif step.side is not None and r.random() < 0.8:
            changed = structs.replace(step, side=_SIDES[step.side])
        elif step.mode is not None and r.random() < 0.6:
            changed = structs.replace(step, mode="to" if step.mode != "to" else "at_least")
        elif step.act in _FLIPPED:
            changed = Step(act=_FLIPPED[step.act])
        else:
            return r.choice(self._recent)
        return structs.replace(program, steps=(*program.steps[:at], changed, *program.steps[at + 1 :]))

    def _slotted(self, scene: Scene) -> tuple[str, Program, str] | None:
        """A command of the slots' generator."""
        sample = next(self._samples)
        slots = slots_of(sample.label)
        said = quantities(sample.text)
        slots = with_numbers(slots, sample.label["number"], said, scene.speed_mps, scene.limit_mps)
        plain = searchable(sample.text)
        slots = corrected(slots, plain)
        steps = steps_of(slots, plain)[:6]
        if slots.outcome == "directive" and not steps:
            return None
        program = Program(outcome=slots.outcome, steps=steps)
        short = sample.language in self._plain and slots.outcome == "directive" and len(sample.text) < 45
        if short and len(steps) == 1 and steps[0].act in ("faster", "slower", "lane", "overtake", "stop", "gap"):
            self._plain[sample.language] = [
                *self._plain[sample.language][-300:],
                (sample.text.rstrip(" .!?,"), program),
            ]
        return sample.text, program, sample.language

    def _said(self, scene: Scene) -> tuple[str, Program, str]:
        """A value, a lane, a courtesy, a warning."""
        language = self._language()
        row = self._r.choice(self._templates["says"])
        text, fields = self._filled(row, language, "step")
        return text, Program(outcome="directive", steps=(Step(**fields),)), language

    def _timed(self, scene: Scene) -> tuple[str, Program, str] | None:
        """A wish that waits for something, or that lasts until something."""
        language = self._language()
        wish = self._wish(language, scene)
        if wish is None:
            return None
        group, key = ("triggers", "when") if self._r.random() < 0.75 else ("lasting", "until")
        said, fields = self._filled(self._r.choice(self._templates[group]), language, key)
        form = self._r.choice(self._words["when"][language] if key == "when" else ["{a} {t}"])
        first = structs.replace(wish[1].steps[0], **{key: Trigger(**fields)})
        program = structs.replace(wish[1], steps=(first, *wish[1].steps[1:]))
        return form.replace("{t}", said).replace("{a}", wish[0]), program, language

    def _ordered(self, scene: Scene) -> tuple[str, Program, str] | None:
        """One thing after another."""
        language = self._language()
        first, then = self._wish(language, scene), self._wish(language, scene)
        if first is None or then is None:
            return None
        form = self._r.choice(self._words["then"][language])
        later = structs.replace(then[1].steps[0], when=Trigger(kind="done"))
        program = Program(outcome="directive", steps=(*first[1].steps, later))
        return form.replace("{a}", first[0]).replace("{b}", then[0]), program, language

    def _followed(self, scene: Scene) -> tuple[str, Program, str]:
        """What goes by the turn before."""
        language = self._language()
        text, fields = self._filled(self._r.choice(self._templates["follows"]), language, "step")
        return text, Program(outcome="unclear", steps=(Step(**fields),)), language

    def _asked_for(self, scene: Scene) -> tuple[str, Program, str]:
        """A question about the ride."""
        row = self._r.choice(rows("questions", "asks"))
        text = self._r.choice(row.fields["matches"])
        return text, Program(outcome="out_of_scope", question=row.fields["question"]), "en"

    def _wish(self, language: str, scene: Scene) -> tuple[str, Program] | None:
        if self._r.random() < 0.3 or not self._plain[language]:
            row = self._r.choice([row for row in self._templates["says"] if row["step"]["act"] in ("drive", "lane")])
            text, fields = self._filled(row, language, "step")
            return text, Program(outcome="directive", steps=(Step(**fields),))
        return self._r.choice(self._plain[language])

    def _filled(self, row: dict[str, Any], language: str, key: str) -> tuple[str, dict[str, Any]]:
        text, fields = self._r.choice(row[language]), dict(row[key])
        if "of" in row:
            number = self._r.choice(row["of"])
            text = text.replace("{n}", str(number))
            fields["value"] = round(number * row.get("factor", 1.0), 3)
        return text, fields

    def _chattered(self, text: str, language: str) -> str:
        chatter = self._words["chatter"].get(language, self._words["chatter"]["en"])
        parts = [self._r.choice(chatter), text if text[-1:] in ".!?" else f"{text}."]
        if self._r.random() < 0.4:
            parts.append(self._r.choice(chatter))
        if self._r.random() < 0.3:
            parts.reverse()
        return " ".join(parts)

    def _language(self) -> str:
        return self._r.choices(LANGUAGES, (44, 10, 10, 9, 9, 9, 9))[0]


def maker(seed: int, held_out: bool = False, with_reader: bool = True) -> Programs:
    """The pairs of the shipped phrases: those to train on, or those of the twentieth that is held out."""
    from slow_node.training.train import split

    embedder = load_embedder()
    parser = IntentParser.load(embedder) if with_reader else None
    reader = ProgramReader(parser) if parser is not None else None
    return Programs(split(load_stock())[held_out], seed, reader, Memory(embedder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", type=int, default=1000)
    parser.add_argument("--held-out", action="store_true", help="of the phrases that nothing is trained on")
    options = parser.parse_args()
    take = partial(next, maker(options.seed, options.held_out).pairs())
    for number in range(1, options.size + 1):
        pair = take()
        chat = program_prompt(pair.asked)
        row = {"id": f"p{number}", "kind": pair.kind, "text": pair.asked.command, "chat": chat, "answer": pair.text}
        sys.stdout.write(json_line(row) + "\n")


if __name__ == "__main__":
    main()
