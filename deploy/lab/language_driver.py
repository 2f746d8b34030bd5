"""The language model as the only driver (`slow_node.baselines.dilu`): its model server, its memory and the worlds it
drives in.

Neither our policy nor our mask takes part; a decision is executed as it is. The world is either paused while the model
thinks, or runs on: then a decision takes effect once the world has run for as long as the model took, and the
set-points hold until then. Only the memory was gathered with our rules and our mask, in other episodes.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deploy.lab.episodes import has_choice, load, published, record, task_of
from deploy.run.launch import model_token
from deploy.run.model_choice import KEY, choose_model
from deploy.run.model_server import embedded_server
from fast_node.policies.rule import rule_logits
from fast_node.training.rollout import Driver, Fleet
from schemas.driving.episode import held
from schemas.driving.road import HZ, VX
from schemas.runtime.clock import NS, Clock, MonotonicClock
from schemas.runtime.process import ConfigError
from schemas.wire.messages import POLICY_ACTIONS, MetaAction, Observation
from sim_node.engine.batched import Batched
from sim_node.metrics import Settled
from sim_node.results import EpisodeResult
from sim_node.scenarios import SCENARIOS, Scenario
from slow_node.baselines.dilu import Bank, Experience, build_prompt, describe, explain, parse
from slow_node.llm.dialect import Chat
from slow_node.llm.embedding import load_embedder
from slow_node.llm.errors import ModelError, ModelTimeoutError
from slow_node.llm.model import MAX_TOKENS, ChatModel

MAX_TOKENS_EMBEDDED = 64
"""More than twice an example's answer: what is longer has lost the thread."""
BUDGET_S = 60.0
FIVE = tuple(MetaAction)[:POLICY_ACTIONS]
LESSONS = ("highway", "merge", "two-way")
LESSON_SEEDS = range(20)
"""Far from those of evaluation."""
CAPPED_MPS = 0.5
"""A speed cap this far below the speed is a lesson in slowing down."""
LESSONS_EACH = 3
"""Experiences for every action of every scenario, where the teacher took it that often."""


@dataclass(frozen=True)
class Said:
    """A model's answer and the server's count of tokens."""

    text: str
    prompt_tokens: int = 0
    answer_tokens: int = 0


Ask = Callable[[Chat], Said]
"""Raises `ModelTimeoutError` where no answer comes in time, and `ConfigError` where the model cannot be used."""


@dataclass
class Metrics:
    """What the model did, over several episodes."""

    latencies_s: list[float] = field(default_factory=list)
    """Of every decision: description, retrieval and model."""
    unparseable: int = 0
    """Answers without an action id, and questions without an answer: the set-points hold."""
    prompt_tokens: int = 0
    answer_tokens: int = 0
    chosen: dict[str, int] = field(default_factory=lambda: {a.name.lower(): 0 for a in FIVE})

    def summary(self) -> dict[str, Any]:
        """For a table: counts, shares, latencies in seconds, tokens per decision."""
        n = len(self.latencies_s)
        p50, p95 = np.percentile(self.latencies_s or [math.nan], (50, 95))
        return {
            "decisions": n,
            "unparseable_share": self.unparseable / max(n, 1),
            "latency_p50_s": float(p50),
            "latency_p95_s": float(p95),
            "prompt_tokens": self.prompt_tokens / max(n, 1),
            "answer_tokens": self.answer_tokens / max(n, 1),
            "chosen": dict(self.chosen),
        }


@contextlib.contextmanager
def running_model(threads: int = 1) -> Iterator[Ask]:
    """The endpoint that the environment names, or the embedded model's process. Raises `ConfigError`."""
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that the model ends with us
    chosen = choose_model()
    if not chosen.embedded:
        print(f"fastslow: asks {chosen.where}", file=sys.stderr)
    server = embedded_server(chosen.port, threads, adapter=False, weights=chosen.weights) if chosen.embedded else None
    try:
        if chosen.embedded and server is None:
            raise ConfigError("the embedded model did not start: see `fastslow doctor`, or set OPENAI_API_KEY")
        key = model_token() if chosen.embedded else os.environ.get(KEY, "")
        model = ChatModel(
            chosen.base_url, chosen.name, key, max_tokens=MAX_TOKENS_EMBEDDED if chosen.embedded else MAX_TOKENS
        )
        with asyncio.Runner() as loop:
            try:
                yield lambda chat: _answer(loop, model, chat)
            finally:
                loop.run(model.close())
    finally:
        if server is not None:
            server.end()
        signal.signal(signal.SIGTERM, before)


def _answer(loop: asyncio.Runner, model: ChatModel, chat: Chat) -> Said:
    prompt, answer = model.prompt_tokens, model.answer_tokens
    try:
        text = loop.run(model.complete(chat, None, BUDGET_S))
    except ModelTimeoutError:
        raise
    except ModelError as error:  # without its model it would drive by doing nothing
        raise ConfigError(str(error)) from None
    return Said(text, model.prompt_tokens - prompt, model.answer_tokens - answer)


class World:
    """One scenario's road, one episode at a time, with a passenger in a hurry."""

    def __init__(self, scenario: Scenario, scenes: int = 1, *, masked: bool = True) -> None:
        self.scenario = scenario
        self.batch = Batched(scenario, scenes, 0)
        self.fleet = Fleet(self.batch, task_of(scenario), masked=masked)

    def load(self, scene: int, seed: int) -> None:
        """That seed's traffic and wish."""
        load(self.fleet, self.scenario, scene, seed, "hurry")

    def wish(self) -> None:
        """The lane that the passenger wishes each ego in now, for the measures."""
        self.fleet.look()

    def state(self) -> tuple[NDArray[Any], ...]:
        """What the egos see now, by scene: rows, speed and lane set-points, the lane that a change left."""
        batch = self.batch
        return tuple(a.copy() for a in (batch.rows, batch.target_speed, batch.target_lane, batch.previous_lane))

    def observation(self, state: tuple[NDArray[Any], ...], scene: int, tick: int) -> Observation:
        """A scene's part of a `state` as it is published."""
        rows, target_speed, target_lane, previous_lane = (array[scene] for array in state)
        return published(
            self.scenario,
            tick,
            rows,
            target_speed_mps=float(target_speed),
            target_lane=int(target_lane),
            previous_lane=int(previous_lane),
        )


def lessons(scenarios: Sequence[str] = LESSONS, seeds: Sequence[int] = LESSON_SEEDS) -> list[Experience]:
    """The memory: scenes in which our rule driver, behind the mask, took each of the five actions. Deterministic.

    At most `LESSONS_EACH` for every scenario and action, spread over the episodes.
    """
    found: list[Experience] = []
    for name in scenarios:
        world = World(SCENARIOS[name], len(seeds))
        for scene, seed in enumerate(seeds):
            world.load(scene, seed)
        taken: dict[MetaAction, list[Observation]] = {action: [] for action in FIVE}
        driver = Driver(world.fleet, rule_logits, stateless=True)
        for tick in range(round(world.scenario.duration_s * HZ)):
            before, scenes = world.state(), np.flatnonzero(~world.fleet.over())
            driver.tick()
            for scene in scenes.tolist():
                action = MetaAction(driver.meta[scene])
                slower = world.fleet.world.rows[scene, 0, VX] - world.fleet.cap_mps[scene] > CAPPED_MPS
                if action == MetaAction.CRUISE and slower and tick % HZ == 0:
                    action = MetaAction.SLOW_DOWN  # what the speed cap does for our drivers, this one does itself
                # CRUISE is what it holds between two decisions, too: one a second is enough.
                if action in taken and (action != MetaAction.CRUISE or tick % HZ == 0):
                    taken[action].append(world.observation(before, scene, tick))
        for action, seen in taken.items():
            step = max(math.ceil(len(seen) / LESSONS_EACH), 1)
            found += [Experience(describe(one), explain(one, action), action) for one in seen[::step]]
    return found


class LanguageDriver:
    """Decides by asking; counts and times what it asks."""

    def __init__(self, bank: Bank, ask: Ask, clock: Clock) -> None:
        self._bank, self._ask, self._clock = bank, ask, clock
        self.metrics = Metrics()

    def decide(self, observation: Observation) -> tuple[MetaAction, float]:
        """The action and how long it took to find [s]; CRUISE (their IDLE) where the answer names none."""
        metrics, began_ns = self.metrics, self._clock.now_ns()
        scene = describe(observation)
        try:
            said = self._ask(build_prompt(scene, self._bank.nearest(scene)))
        except ModelTimeoutError:
            said = Said("")
        took_s = (self._clock.now_ns() - began_ns) / NS
        action = parse(said.text)
        metrics.latencies_s.append(took_s)
        metrics.prompt_tokens += said.prompt_tokens
        metrics.answer_tokens += said.answer_tokens
        if action is None:
            metrics.unparseable += 1
            return MetaAction.CRUISE, took_s
        metrics.chosen[action.name.lower()] += 1
        return action, took_s


def drive_dilu(
    scenario: Scenario, seeds: Sequence[int], *, paused: bool, ask: Ask, bank: Bank, clock: Clock | None = None
) -> tuple[list[EpisodeResult], Metrics]:
    """One episode per seed, with its traffic and a passenger in a hurry; and what the model did in them.

    paused: the world stands still while the model thinks. Else a decision waits until the world has run for as long,
    and the next question, about the scene of that moment, is asked when it arrives, at most one a second.
    `bank`: see `memory`. Raises `ConfigError` where the model cannot be used.
    """
    driver = LanguageDriver(bank, ask, clock or MonotonicClock())
    world = World(scenario, masked=False)
    results = []
    for seed in seeds:
        world.load(0, seed)
        results.append(_episode(world, driver, paused))
    return results, driver.metrics


def _episode(world: World, driver: LanguageDriver, paused: bool) -> EpisodeResult:
    waiting: tuple[int, MetaAction] | None = None
    ask_from = 0

    never = np.zeros(1, np.bool_)
    holding = int(MetaAction.CRUISE)

    def step(tick: int) -> Settled:
        nonlocal waiting, ask_from, holding
        meta, decided = MetaAction(holding), False
        if waiting is not None and waiting[0] <= tick:
            meta, waiting, decided = waiting[1], None, True
        if waiting is None and tick >= ask_from:
            action, took_s = driver.decide(world.observation(world.state(), 0, tick))
            ask_from = tick + HZ  # at most one question a second, as theirs
            if paused:
                meta, decided = action, True
            else:
                waiting = tick + max(math.ceil(took_s * HZ), 1), action
        holding = held(int(meta))
        world.wish()
        world.batch.tick(np.full(1, int(meta)), world.fleet.v_des)
        return Settled(np.full(1, decided), has_choice(world.fleet), never, never)

    return record(world.fleet, world.scenario, step)[0]


@functools.cache
def memory() -> Bank:
    """The driver's memory, gathered once."""
    return Bank(load_embedder(), lessons())
