"""`fastslow study --memory`: what remembering changes in driving. The same commands and seeds with and without it, in
lock-step, with the nodes that drive.

Two passengers. One gets carsick and has said so on an earlier drive; on this one he is in a hurry. The other likes
5 km/h more, says "faster", and "that's too much" as soon as it is; on an earlier drive that has happened before. Both
speak; nobody tells the car what they like. The earlier drive is on another seed. Without memory the car starts with
the shipped examples, as everybody's does the first time.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deploy.lab.lockstep import drive
from deploy.lab.statistics import t_interval
from fast_node.policies.load import load_policy
from fast_node.policies.policy import NamedPolicy
from schemas.driving.measures import INF
from schemas.driving.road import HZ
from schemas.runtime.process import CONFIG, OK, ConfigError
from schemas.wire.messages import Command, Directive, Event, Observation
from sim_node.config import SimConfig
from sim_node.node import SimNode
from slow_node.deliberation import Deliberation
from slow_node.effects import Effect, Interpret, Prefer, Remember, keep
from slow_node.interpretation import Interpretation
from slow_node.lessons import lesson_for
from slow_node.llm.embedding import load_embedder
from slow_node.memory.bank import Memory
from slow_node.memory.preferences import Manner
from slow_node.planning.scene import Scene, encode_scene
from slow_node.planning.steps import summary
from slow_node.understanding.intent_parser import IntentParser
from slow_node.understanding.reading.reader import ProgramReader

DURATION_S, SAID_S = 40.0, 3.0
EARLIER_SEEDS = 700_000
"""The earlier drives are on seeds from here on."""
EARLIER_DRIVES = 5
"""So many at most, until one was too much: in dense traffic none is."""
LIKED_MPS, TOO_MUCH_MPS, NEAR_MPS = 5 / 3.6, 1.0, 1.0
"""What the second passenger likes; how much more is too much; and how near is right."""

Speaks = Callable[[float, Scene], str]
"""What a passenger says at a time [s] in a scene; "": nothing."""


@dataclass
class Drive:
    """One drive, measured from the first word on."""

    speeds: list[float] = field(default_factory=list)
    accelerations: list[float] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    min_ttc_s: float = INF
    collided: bool = False

    def comfort(self) -> dict[str, float]:
        """Root mean squares of acceleration and jerk, mean speed, smallest time to collision; SI units."""
        a = np.array(self.accelerations)
        return {
            "accel_rms": float(np.sqrt(np.mean(a**2))),
            "jerk_rms": float(np.sqrt(np.mean((np.diff(a) * HZ) ** 2))),
            "speed_mps": float(np.mean(self.speeds)),
            "min_ttc_s": min(self.min_ttc_s, 30.0),
            "collisions": float(self.collided),
        }

    def liked(self, wanted_mps: float) -> dict[str, float]:
        """How the second passenger was served: mean speed beyond the liked one [m/s], share near it, corrections."""
        v = np.array(self.speeds)
        return {
            "beyond_mps": float(np.mean(np.maximum(v - wanted_mps, 0.0))),
            "near_share": float(np.mean(np.abs(v - wanted_mps) <= NEAR_MPS)),
            "corrections": float(sum(text != "faster" for text in self.said)),
            "collisions": float(self.collided),
        }


class Slow:
    """The slow node in lock-step: deliberation, program reader and memory, without thinking time."""

    def __init__(self, reader: ProgramReader, memory: Memory, speaks: Speaks) -> None:
        self._reader, self._memory, self._speaks = reader, memory, speaks
        self._deliberation = Deliberation()
        self._deliberation.manner = Manner.of(memory.preferences())
        self._events: list[Event] = []
        self.said: list[str] = []

    def heard(self, events: Sequence[Event]) -> None:
        """What the fast node has reported."""
        self._events += events

    def ask(self, observation: Observation, now_ns: int) -> Directive | None:
        """The newest directive that comes of this tick."""
        scene = encode_scene(observation)
        out: list[Effect] = list(self._deliberation.on_scene(scene, now_ns))
        events, self._events = self._events, []
        for event in events:
            out += self._deliberation.on_event(event, now_ns)
        text = self._speaks(observation.tick / HZ, scene)
        if text:
            self.said.append(text)
            command = Command(epoch=scene.epoch, stamp_ns=now_ns, id=len(self.said), text=text)
            for effect in self._deliberation.on_command(command, now_ns):
                if isinstance(effect, Interpret):
                    out += self._deliberation.on_interpretation(effect.id, self._found(text, scene), now_ns)
        for effect in out:
            if isinstance(effect, Remember | Prefer):
                keep(self._memory, effect)
        return next((effect for effect in reversed(out) if isinstance(effect, Directive)), None)

    def _found(self, text: str, scene: Scene) -> Interpretation:
        reading = self._reader.read(text, scene.speed_mps, scene.limit_mps)
        slots = reading.slots or summary(reading.program, scene, reading.language)
        lesson = lesson_for(slots, scene, self._memory.nearest(text, 4))
        return Interpretation(slots, source="parser", program=reading.program, lesson=lesson)


def once(text: str) -> Speaks:
    """Says it at `SAID_S`."""
    return lambda at_s, _: text if round(at_s * HZ) == round(SAID_S * HZ) else ""


class Moderate:
    """Wants `LIKED_MPS` more than he had at `SAID_S`; complains no more often than every five seconds."""

    def __init__(self) -> None:
        self.wanted_mps, self._quiet_until_s = INF, 0.0

    def __call__(self, at_s: float, scene: Scene) -> str:
        if round(at_s * HZ) == round(SAID_S * HZ):
            self.wanted_mps, self._quiet_until_s = scene.speed_mps + LIKED_MPS, at_s
            return "faster"
        if scene.speed_mps > self.wanted_mps + TOO_MUCH_MPS and at_s >= self._quiet_until_s:
            self._quiet_until_s = at_s + 5.0
            return "that's too much"
        return ""


def driven(scenario: str, seed: int, slow: Slow, policy: NamedPolicy, duration_s: float = DURATION_S) -> Drive:
    """One drive with this slow side."""
    sim, found = SimNode(SimConfig(scenario=scenario, seed=seed)), Drive()
    for tick in drive(sim, policy, slow.ask, duration_s):
        slow.heard(tick.events)
        if tick.observation.tick >= SAID_S * HZ:
            found.speeds.append(sim.speed_mps)
            found.accelerations.append(tick.observation.acceleration_mps2)
    found.said, found.min_ttc_s, found.collided = slow.said, sim.metrics.min_ttc_s, sim.metrics.collisions > 0
    return found


def carsick(
    scenario: str, seed: int, reader: ProgramReader, memory: Memory, policy: NamedPolicy, remembers: bool
) -> dict[str, float]:
    """A hurry of somebody who gets carsick and has said so on an earlier drive."""
    if remembers:
        driven(scenario, EARLIER_SEEDS + seed, Slow(reader, memory, once("I get carsick")), policy, SAID_S + 1.0)
    slow = Slow(reader, memory, once("I'm in a hurry, drive faster"))
    return driven(scenario, seed, slow, policy).comfort()


def moderate(
    scenario: str, seed: int, reader: ProgramReader, memory: Memory, policy: NamedPolicy, remembers: bool
) -> dict[str, float]:
    """A "faster" of somebody for whom it was too much on an earlier drive."""
    for number in range(EARLIER_DRIVES if remembers else 0):
        earlier = Slow(reader, memory, Moderate())
        if len(driven(scenario, EARLIER_SEEDS + EARLIER_DRIVES * seed + number, earlier, policy).said) > 1:
            break  # it was too much: that is what there is to learn
    passenger = Moderate()
    found = driven(scenario, seed, Slow(reader, memory, passenger), policy)
    return found.liked(passenger.wanted_mps)


PASSENGERS = {
    "gets carsick": (carsick, ("highway", "two-way")),
    "likes it moderate": (moderate, ("highway", "highway-natural")),
}


def run_memory(seeds: int, roads: Sequence[str] | None, *, as_json: bool) -> int:
    """The experiment, on these roads only, where any are named. Exit code."""
    try:
        rows = [
            row
            for name, (_, own) in PASSENGERS.items()
            for scenario in own
            if not roads or scenario in roads
            for row in _compared(name, scenario, seeds)
        ]
    except ConfigError as error:
        print(f"fastslow: {error}", file=sys.stderr)
        return CONFIG
    if as_json:
        print(json.dumps({"schema": "fastslow.memory-study/1", "seeds": seeds, "rows": rows}))
        return OK
    print(f"{'passenger':<19}{'road':<17}{'measure':<13}{'without':>9}{'with':>9}  difference (95 %, paired)")
    for row in rows:
        low, high = row["difference_ci95"]
        print(
            f"{row['passenger']:<19}{row['scenario']:<17}{row['measure']:<13}{row['without']:>9.2f}{row['with']:>9.2f}"
            f"  {row['difference']:+.2f} ({low:+.2f} to {high:+.2f})"
        )
    return OK


def _compared(name: str, scenario: str, seeds: int) -> list[dict[str, Any]]:
    """Every measure of one passenger on one road, without and with memory."""
    embedder, policy = load_embedder(), load_policy()
    parser = IntentParser.load(embedder)
    if parser is None:
        raise ConfigError("MiniLM is not installed: run `make setup`")
    reader, passenger = ProgramReader(parser), PASSENGERS[name][0]
    found: dict[bool, list[dict[str, float]]] = {False: [], True: []}
    for seed in range(seeds):
        for remembers in (False, True):
            memory = Memory(embedder, "")
            found[remembers].append(passenger(scenario, seed, reader, memory, policy, remembers))
            memory.close()
        print(f"{name}, {scenario}: {seed + 1} of {seeds}", file=sys.stderr, flush=True)
    rows = []
    for measure in found[False][0]:
        without, with_it = ([one[measure] for one in found[which]] for which in (False, True))
        mean, half = t_interval([b - a for a, b in zip(without, with_it, strict=True)])
        rows.append(
            {
                "passenger": name,
                "scenario": scenario,
                "measure": measure,
                "without": float(np.mean(without)),
                "with": float(np.mean(with_it)),
                "difference": mean,
                "difference_ci95": [mean - (half or 0.0), mean + (half or 0.0)],
            }
        )
    return rows
