"""The slow node's shell: bus and model around `Deliberation`, in one asyncio loop that never waits for the model."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace

import msgspec

from schemas.runtime.bus import Bus, open_bus
from schemas.runtime.process import ConfigError, Heartbeat, log
from schemas.wire import topics
from schemas.wire.codec import Fault, decode_command
from schemas.wire.messages import Directive, Event, EventKind, Reply
from slow_node.asking import Style
from slow_node.config import BUDGET_S, TOKEN, SlowConfig
from slow_node.deliberation import Deliberation
from slow_node.effects import Abandon, Effect, Interpret, Prefer, Remember, keep
from slow_node.interpretation import Interpretation
from slow_node.interpreter import ENDPOINT_TRUST, SURE, Interpreter
from slow_node.journal import Diary
from slow_node.lessons import lesson_for
from slow_node.llm.adapter import read_adapter
from slow_node.llm.embedding import load_embedder
from slow_node.llm.endpoint import is_loopback
from slow_node.llm.model import MAX_TOKENS, MAX_TOKENS_SHORT, ChatModel
from slow_node.memory.bank import Memory
from slow_node.memory.examples import EXAMPLES
from slow_node.memory.preferences import Manner
from slow_node.planning.scene import encode_scene
from slow_node.telemetry import telemetry_of
from slow_node.thought import ThoughtsFile, Trace, shortened, thought_of
from slow_node.unanswered import Unanswered
from slow_node.unanswered import told as ended
from slow_node.understanding.intent_parser import IntentParser
from slow_node.understanding.reading.reader import ProgramReader

NAME = "slow"
POLL_S = 0.03
LAST_CHORES_S = 1.0
"""So long the end waits for what is still to be kept in the memory bank."""


class SlowNode:
    """Polls the bus, feeds the deliberation, carries its effects out."""

    def __init__(
        self,
        bus: Bus,
        memory: Memory,
        model: ChatModel,
        interpreter: Interpreter,
        budget_s: float = BUDGET_S,
        thoughts_path: str = "",
        wishes_path: str = "",
    ) -> None:
        self._bus, self._memory, self._model, self._interpreter = bus, memory, model, interpreter
        self._observations = bus.subscribe(topics.OBSERVATION)
        self._commands = bus.subscribe_bytes(topics.COMMAND)
        self._events = bus.subscribe(topics.EVENT)
        self._deliberation = Deliberation(budget_s, asks_again=interpreter.asks_again)
        self._diary = Diary(lambda journal: bus.publish(topics.JOURNAL, journal))
        self._deliberation.manner = Manner.of(memory.preferences())
        if self._deliberation.manner.kinds:
            self._diary.manner(self._deliberation.manner.kinds, time.monotonic_ns())
        self._interpretation: asyncio.Task[None] | None = None
        self._chores: set[asyncio.Task[None]] = set()
        self._bank = asyncio.Lock()
        self._seen: tuple[int, int] | None = None
        self._model_ms = 0.0
        self._thoughts = ThoughtsFile(thoughts_path)
        self._unanswered = Unanswered(wishes_path)
        self._left = list(self._unanswered.left)
        self._telemetry = telemetry_of(model)
        self._told_s = 0.0

    def metrics(self) -> dict[str, float]:
        """For the heartbeat; called from its thread."""
        return {
            **self._deliberation.metrics,
            "calls": float(self._model.calls),
            "model_ms": self._model_ms,
            "tokens": float(self._model.prompt_tokens + self._model.answer_tokens),
            **({"cost_usd": cost} if (cost := self._model.cost_usd) is not None else {}),
        }

    async def run(self, stopped: Callable[[], bool] = lambda: False, heart: Heartbeat | None = None) -> None:
        """Until `stopped`, which tests use; a process is ended by its signals."""
        try:
            while not stopped():
                if heart is not None:
                    heart.begin()
                    heart.epoch = self._deliberation.epoch
                try:
                    self.poll(time.monotonic_ns())
                except Exception as error:  # what cannot be thought about now is no reason to stop thinking
                    self._tell_of(error)
                if heart is not None:
                    heart.end()
                await asyncio.sleep(POLL_S)
        finally:
            self._abandon()
            self._diary.flush(time.monotonic_ns())
            if self._chores:
                await asyncio.wait(self._chores, timeout=LAST_CHORES_S)
            await self._model.close()
            self._telemetry.close()

    def poll(self, now_ns: int) -> None:
        """One round: the newest observation, then what the fast node reports, then the passenger."""
        observation = self._observations.peek()
        if observation is not None and (observation.epoch, observation.tick) != self._seen:
            self._seen = (observation.epoch, observation.tick)
            self._diary.scene(observation.epoch, observation.tick, now_ns)
            self._carry_out(self._deliberation.on_scene(encode_scene(observation), now_ns))
            # Only now: who listens is known to a fresh process no earlier than who speaks.
            if self._left:
                left, self._left = self._left, []
                self._carry_out([ended(wish, observation.epoch, now_ns) for wish in left])
        for event in self._events.take():
            self._diary.event(event, now_ns)
            self._carry_out(self._deliberation.on_event(event, now_ns))
        for number, payload in enumerate(self._commands.take()):
            arrival_id = now_ns // 1000 + number
            try:
                command = decode_command(payload, fallback_id=arrival_id, epoch=self._deliberation.epoch, now_ns=now_ns)
            except Fault as fault:
                self._diary.refused(str(fault), arrival_id, now_ns)
                self._carry_out(self._deliberation.refuse_payload(str(fault), arrival_id, now_ns))
                continue
            self._diary.command(command, now_ns)
            try:
                self._carry_out(self._deliberation.on_command(command, now_ns))
            except Exception as error:  # a passenger must get an answer even where this broke
                self._tell_of(error)
                why = f"internal error: {type(error).__name__}"
                self._carry_out(self._deliberation.refuse_payload(why, command.id, now_ns))

    def _tell_of(self, error: Exception) -> None:
        """Log an error of ours, once a second at most."""
        now_s = time.monotonic()
        if now_s - self._told_s >= 1.0:
            self._told_s = now_s
            log(NAME, "fault", f"{type(error).__name__}: {error}"[:500])

    def _carry_out(self, effects: list[Effect]) -> None:
        """Do them; and keep what is open after them, which nothing else changes."""
        if not effects:
            return
        for effect in effects:
            match effect:
                case Directive():
                    self._bus.publish(topics.DIRECTIVE, effect)
                case Reply():
                    self._bus.publish(topics.REPLY, effect)
                    log(NAME, effect.outcome, effect.why, command_id=effect.command_id, text=effect.text)
                case Event():
                    self._bus.publish(topics.EVENT, effect)
                case Interpret():
                    self._abandon()
                    self._interpretation = asyncio.get_running_loop().create_task(self._interpret(effect))
                case Abandon():
                    self._abandon()
                case Remember() | Prefer():
                    chore = asyncio.get_running_loop().create_task(self._remember(effect))
                    self._chores.add(chore)
                    chore.add_done_callback(self._chores.discard)
        self._unanswered.keep([*self._left, *self._deliberation.open_wishes()])

    def _abandon(self) -> None:
        if self._interpretation is not None:
            self._interpretation.cancel()
            self._interpretation = None

    async def _interpret(self, effect: Interpret) -> None:
        trace = Trace(again=effect.context.again)
        first: list[Reply] = []
        try:
            found = await self._interpreter.interpret(
                effect.command,
                effect.scene,
                effect.context,
                trace,
                lambda provisional: first.extend(self._take(effect, provisional)),
            )
        except asyncio.CancelledError:
            told = first[0].outcome if first else "superseded"
            self._record(trace, Interpretation(None, source="parser" if first else trace.model), effect, told)
            raise
        except Exception as error:  # a passenger must get an answer even where this broke
            log(NAME, "fault", f"{type(error).__name__}: {error}")
            found = Interpretation(None, f"internal error: {type(error).__name__}", model_answered=False)
        if found.model_ms:
            self._model_ms = found.model_ms
        # Forgotten before its effects: they must not cancel the task that carries them out.
        self._interpretation = None
        replies = [*first, *self._take(effect, found)]
        reply = replies[0] if replies else None
        trace.guards += [one.why for one in replies if one.why]
        self._record(trace, found, effect, reply.outcome if reply else "issued" if effect.id < 0 else "superseded")

    def _take(self, effect: Interpret, found: Interpretation) -> list[Reply]:
        """Have an interpretation counted and carried out; the replies to its command."""
        if found.slots is not None:
            found = replace(found, lesson=lesson_for(found.slots, effect.scene, found.nearest))
        now_ns = time.monotonic_ns()
        self._diary.interpretation(effect.id, found, now_ns)
        try:
            effects = self._deliberation.on_interpretation(effect.id, found, now_ns)
        except Exception as error:
            self._tell_of(error)
            why = f"internal error: {type(error).__name__}"
            effects = self._deliberation.refuse_payload(why, effect.command_id, now_ns)
        self._carry_out(effects)
        return [e for e in effects if isinstance(e, Reply) and e.outcome not in ("superseded", "cancelled")]

    def _record(self, trace: Trace, found: Interpretation, asked: Interpret, outcome: str) -> None:
        """Tell how the command came to be understood, with what became of it."""
        thought = thought_of(
            trace,
            epoch=self._deliberation.epoch,
            stamp_ns=time.monotonic_ns(),
            command_id=asked.command_id,
            command=asked.command,
            source=found.source,
            outcome=outcome,
            slots=found.slots,
        )
        self._thoughts.write(thought)
        self._telemetry.thought(trace, thought)
        self._bus.publish(topics.THOUGHT, shortened(thought))

    async def _remember(self, effect: Remember | Prefer) -> None:
        """One after the other: what was said last holds."""
        async with self._bank:
            try:
                await asyncio.to_thread(keep, self._memory, effect)
            except Exception as error:  # a bank that is locked, full, or damaged meanwhile: the car drives on without
                log(NAME, "memory", f"not kept: {type(error).__name__}: {error}"[:300])


def build(bus: Bus, config: SlowConfig) -> tuple[SlowNode, Memory]:
    """The node with its parts; the caller closes the memory. Where the bank cannot be used, one that ends with us."""
    try:
        interpreter, memory, model = build_interpreter(config)
    except ConfigError as error:
        interpreter, memory, model = build_interpreter(msgspec.structs.replace(config, memory_path=""))
        said = f"going on without what was remembered: {error}"
        log(NAME, "memory", said)
        now_ns = time.monotonic_ns()
        bus.publish(
            topics.EVENT, Event(epoch=0, stamp_ns=now_ns, kind=EventKind.FAULT, node=NAME, tick=-1, detail=said)
        )
    return SlowNode(bus, memory, model, interpreter, config.budget_s, config.thoughts_path, config.wishes_path), memory


def build_interpreter(
    config: SlowConfig, *, scene: bool = True, chat_model: Callable[..., ChatModel] = ChatModel, key: str | None = None
) -> tuple[Interpreter, Memory, ChatModel]:
    """What interprets commands, without the bus: the caller closes the memory and the model.

    scene: whether the model is told of it. chat_model: makes the client of the model's server. key: what that is shown;
    None: what the environment has.
    """
    embedder = load_embedder()
    memory = Memory(embedder, config.memory_path, EXAMPLES if config.shipped_examples else None)
    if key is None:
        key = os.environ.get(TOKEN if config.embedded else config.api_key_env, "")
    if not key and not config.embedded and not is_loopback(config.base_url):
        log(NAME, "key", f"{config.api_key_env} is not set; calling {config.base_url} without a key")
    most = config.max_tokens or (MAX_TOKENS_SHORT if config.embedded else MAX_TOKENS)
    adapted = config.embedded and config.adapter
    model = chat_model(config.base_url, config.model, key, max_tokens=most, odds=adapted)
    ask = config.ask if config.ask != "auto" else "unsure" if config.embedded and not adapted else "always"
    parser = IntentParser.load(embedder) if config.parser else None
    reader = ProgramReader(parser) if parser is not None else None
    learnt = read_adapter() if adapted else None
    style: Style = "full" if not config.embedded else "short" if learnt is None else learnt.answers
    trust = ENDPOINT_TRUST if not config.embedded else SURE if learnt is None else learnt.trust
    interpreter = Interpreter(
        memory, model, reader, style=style, k=config.k, budget_s=config.budget_s, ask=ask, trust=trust, scene=scene
    )
    return interpreter, memory, model


async def _until_signal(node: SlowNode, heart: Heartbeat) -> None:
    """Signals become a flag: an exception raised by a handler could end an interpretation instead of the node."""
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    await node.run(stop.is_set, heart)


def serve(config: SlowConfig) -> None:
    """Run until a signal."""
    with open_bus(config.bus) as bus:
        node, memory = build(bus, config)
        try:
            with Heartbeat(bus, NAME, node.metrics) as heart:
                log(NAME, "ready", base_url=config.base_url, model=config.model, examples=len(memory))
                asyncio.run(_until_signal(node, heart))
        finally:
            memory.close()
