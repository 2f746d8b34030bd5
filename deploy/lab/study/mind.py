"""`fastslow study --mind`: what a language model that comes late is worth at the wheel.

The same commands are said on the same roads and seeds, each in an episode of its own, in lock-step; who understands
them, and how many seconds later the answer comes, differs. Answers are kept by prompt, episodes as they end: the same
command goes on where it was stopped, and with the same answers it gives the same table.

Drivers: `none` (nobody listens), `reader` (the quick reader alone), `model` (the embedded model alone, behind the
refusals), `both` (as it ships: the reader first, the model's verdict when it comes), `endpoint` (`both` with the
endpoint that the environment names, if it names one). The delay is added to `reader` and `model` alone, and in `both`
and `endpoint` to the model only. At no added delay the prompt's parts are left out in turn, where the model is told
of them: the embedded one is not, while its adapter answers with slots.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import mean
from typing import Any

from deploy.lab.cached_model import kept_in
from deploy.lab.files import whole_lines
from deploy.lab.interpreter import running_interpreter
from deploy.lab.rider import Heard, Ridden, Rider, Wish, question, ride, scene_at
from deploy.run.model_choice import choose_model
from deploy.run.processes import ModelOptions
from fast_node.policies.load import load_policy
from schemas.wire.program import Step
from schemas.wire.text import json_line
from sim_node.results import ride_interval
from slow_node.effects import Interpret
from slow_node.evaluation.score import wilson95
from slow_node.interpretation import Interpretation
from slow_node.interpreter import Interpreter
from slow_node.llm.adapter import read_adapter
from slow_node.planning.program_text import written
from slow_node.planning.scene import Scene

SCHEMA = "fastslow.mind-study/1"
DRIVERS = ("none", "reader", "model", "both", "endpoint")
DELAYS_S = (0.0, 1.0, 2.0, 5.0, 10.0)
ABLATIONS = ("scene", "memory")
FIRST_SEED, SEEDS = 7000, 3
AT_S, DURATION_S = 4.0, 34.0
_ROW = b'{"driver": '
"""How a line of the episodes begins."""
READER_S, MODEL_S = 0.06, 1.0
"""How long they take without any added delay: what was measured beside the running stack, rounded."""

LEFT, RIGHT = Step(act="lane", side="left", count=1), Step(act="lane", side="right", count=1)
WISHES = (
    Wish("highway", "could you get us there a little sooner, my train leaves at nine", (Step(act="faster"),)),
    Wish("highway", "pop over into the lane on our left when you get the chance", (LEFT,)),
    Wish("highway", "we sit far too close to him, drop back a good bit", (Step(act="farther"),)),
    Wish("highway", "knock it down to seventy, would you", (Step(act="drive", value=70 / 3.6, unit="mps"),)),
    Wish("highway", "geh doch mal eine Spur weiter nach rechts", (RIGHT,)),
    Wish("highway", "in ten seconds shift across to the right lane", (RIGHT,), after_s=10.0),
    Wish("highway", "erm, the whatsit, the room in front of us, bigger please", (Step(act="farther"),)),
    Wish("two-way", "get past this slowcoach, will you", (Step(act="overtake"),)),
    Wish("two-way", "my stomach is turning, take it down a notch", (Step(act="slower"),)),
    Wish("two-way", "on est en retard, dépêche-toi un peu", (Step(act="faster"),)),
    Wish("highway", "what do you fancy for dinner tonight"),
    Wish("highway", "give the cyclist a little nudge off the road"),
)
"""Said to nobody before: in no labelled set, and no phrase to train on."""


@dataclass(frozen=True)
class Condition:
    """Who understands, how much later, and without what."""

    driver: str
    delay_s: float = 0.0
    without: str = ""


def conditions(*, endpoint: bool, told: bool, delays_s: Sequence[float] = DELAYS_S) -> list[Condition]:
    """The rows of the table. told: whether the embedded model's prompt has more than the command."""
    late = ["reader", "model", "both", *(["endpoint"] if endpoint else [])]
    asked = [*(["both"] if told else []), *(["endpoint"] if endpoint else [])]
    return [
        Condition("none"),
        *(Condition(driver, delay_s) for driver in late for delay_s in delays_s),
        *(Condition(driver, 0.0, part) for driver in asked for part in ABLATIONS),
    ]


def heard_in(asked: Interpret, interpreter: Interpreter, loop: asyncio.Runner, condition: Condition) -> list[Heard]:
    """What one question comes to under this condition, and when."""
    first: list[Interpretation] = []
    found = loop.run(interpreter.interpret(asked.command, asked.scene, asked.context, act=first.append))
    alone = condition.driver == "reader" or not found.model_asked
    late_s = condition.delay_s if alone or condition.driver in ("model", "both", "endpoint") else 0.0
    heard: list[Heard] = [(READER_S, one) for one in first]
    return [*heard, ((READER_S if alone else MODEL_S) + late_s, found)]


def run_mind_study(out: Path, *, seeds: int = SEEDS, quick: bool = False, as_json: bool = False) -> int:
    """Drive what is missing, write `mind.json`, print the table. quick: one seed, no delay and 5 s. Exit code."""
    out.mkdir(parents=True, exist_ok=True)
    chosen = choose_model()
    told = read_adapter().answers == "programs"
    rows = conditions(endpoint=not chosen.embedded, told=told, delays_s=(0.0, 5.0) if quick else DELAYS_S)
    places = [(wish, FIRST_SEED + n) for n in range(1 if quick else seeds) for wish in WISHES]
    kept = out / "episodes.jsonl"
    known = {_key(row): row for row in whole_lines(kept, _ROW, json.loads)}
    driven = {row["plan"]: Ridden(*(row[name] for name in Ridden.__match_args__)) for row in known.values()}
    for condition in rows:
        missing = [(wish, seed) for wish, seed in places if _key(_named(condition, wish, seed)) not in known]
        if not missing:
            continue
        for row in _driven(condition, missing, kept_in(out / "answers.jsonl"), driven):
            known[_key(row)] = row
            with kept.open("a", encoding="utf-8") as file:
                file.write(json_line(row) + "\n")
        print(f"{condition.driver} +{condition.delay_s:g} s {condition.without}".rstrip(), file=sys.stderr, flush=True)
    table = [
        _summary(condition, [known[_key(_named(condition, wish, seed))] for wish, seed in places]) for condition in rows
    ]
    result = {"schema": SCHEMA, "commands": len(WISHES), "seeds": [seed for _, seed in places[:: len(WISHES)]]}
    result |= {"reader_s": READER_S, "model_s": MODEL_S, "told": told, "rows": table}
    (out / "mind.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result) if as_json else "\n".join(lines(table)))
    if not told and not as_json:
        print("the embedded model is told of the command alone: there is nothing else to leave out")
    return 0


def _driven(
    condition: Condition, places: list[tuple[Wish, int]], chat_model: Any, driven: dict[str, Ridden]
) -> Iterator[dict[str, Any]]:
    """The episodes of one row. driven: those that are known, by plan."""
    policy = load_policy()
    ways: dict[str, dict[str, Any]] = {
        "none": {"ask": "never"},
        "reader": {"ask": "never"},
        "model": {"ask": "always", "parser": False},
    }
    options = dict(ways.get(condition.driver, {"ask": "always"}))
    options["needs_model"] = options["ask"] != "never"
    if condition.without == "memory":
        options |= {"k": 0, "empty_bank": True}
    if condition.driver != "endpoint":
        options |= {"model": ModelOptions(embedded=True)}
    with ExitStack() as stack:
        interpreter = stack.enter_context(
            running_interpreter(**options, chat_model=chat_model, scene=condition.without != "scene")
        )
        loop = stack.enter_context(asyncio.Runner())
        scenes: dict[tuple[str, int], Scene] = {}
        for wish, seed in places:
            verdicts: list[Interpretation] = []

            def interpret(asked: Interpret, verdicts: list[Interpretation] = verdicts) -> list[Heard]:
                heard = heard_in(asked, interpreter, loop, condition)
                verdicts.append(heard[-1][1])
                return heard

            said = None if condition.driver == "none" else wish
            if said is not None and (wish.scenario, seed) not in scenes:
                scenes[wish.scenario, seed] = scene_at(wish.scenario, seed, policy, AT_S)
            heard = interpret(question(wish, scenes[wish.scenario, seed])) if said is not None else []
            asks_again = interpreter.asks_again and bool(heard)
            plan = _plan(wish, seed, heard)
            if plan not in driven or asks_again:
                rider = Rider(said, AT_S, _once(heard, interpret), asks_again=asks_again)
                driven[plan] = ride(wish, rider, policy, seed=seed, at_s=AT_S, duration_s=DURATION_S)
            first = verdicts[0] if verdicts else None
            yield {
                **_named(condition, wish, seed),
                **asdict(driven[plan]),
                "asked": first.model_asked if first else False,
                "decided": first.model_decided if first else False,
                "verdicts": [one.verdict for one in verdicts],
                "plan": plan,
            }
        loop.run(interpreter.close())


def _once(heard: list[Heard], interpret: Callable[[Interpret], list[Heard]]) -> Callable[[Interpret], list[Heard]]:
    """Answers the first question with what is known already, and asks about every further one."""
    known = iter([heard])
    return lambda asked: next(known, None) or interpret(asked)


def _plan(wish: Wish, seed: int, heard: list[Heard]) -> str:
    """All that an episode depends on: two with the same plan are the same drive. What changes nothing is left out."""
    steps = [
        [round(seconds, 3), found.verdict if found.verdict == "withdrew" else "", written(found.program)]
        for seconds, found in heard
        if found.program is not None
        and (found.program.outcome == "directive" or found.verdict == "withdrew")
        and (found.provisional or found.verdict not in ("confirmed", "overruled", "unanswered") or len(heard) == 1)
    ]
    return json.dumps([wish.scenario, seed, wish.text, steps], ensure_ascii=False)


def _named(condition: Condition, wish: Wish, seed: int) -> dict[str, Any]:
    return {**asdict(condition), "scenario": wish.scenario, "seed": seed, "text": wish.text}


def _key(row: dict[str, Any]) -> str:
    return json.dumps([row[name] for name in ("driver", "delay_s", "without", "scenario", "seed", "text")])


def _summary(condition: Condition, episodes: list[dict[str, Any]]) -> dict[str, Any]:
    good, n = sum(row["success"] for row in episodes), len(episodes)
    score, low, high = ride_interval([row["ride_score"] for row in episodes])
    return {
        **asdict(condition),
        "n": n,
        "success": good / n,
        "success_ci95": wilson95(good, n),
        "compliance": mean(row["compliance"] for row in episodes),
        "ride_score": score,
        "ride_score_ci95": [low, high],
        "collisions": sum(row["collided"] for row in episodes),
        "asked": sum(row["asked"] for row in episodes),
        "decided": sum(row["decided"] for row in episodes),
    }


def lines(table: list[dict[str, Any]]) -> Iterator[str]:
    """The table for people."""
    head = f"{'driver':<20}{'delay':>7}{'n':>5}{'success %':>18}{'compliance %':>14}{'ride score':>18}"
    yield f"{head}{'asked':>7}{'decides':>9}"
    for row in table:
        name = row["driver"] + (f", no {row['without']}" if row["without"] else "")
        low, high = (100 * bound for bound in row["success_ci95"])
        ride_low, ride_high = row["ride_score_ci95"]
        ridden = f"{row['ride_score']:.1f}" + (f" ({ride_low:.0f}-{ride_high:.0f})" if ride_low is not None else "")
        yield (
            f"{name:<20}{row['delay_s']:>5g} s{row['n']:>5}{100 * row['success']:>9.1f} ({low:.0f}-{high:.0f})"
            f"{100 * row['compliance']:>14.1f}{ridden:>18}{row['asked']:>7}{row['decided']:>9}"
        )
