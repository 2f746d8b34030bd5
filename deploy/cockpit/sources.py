"""Where a picture comes from: the bus of a running car, or a recording of one."""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cache
from heapq import merge
from typing import Any, Literal, Protocol

from schemas.runtime.bus import Bus
from schemas.runtime.clock import NS
from schemas.wire import topics
from schemas.wire.codec import Fault, decode_command
from schemas.wire.messages import Command, Control, Message, Observation, Status


class Refused(Exception):  # noqa: N818 - a word to the passenger, not a mistake of ours
    """What a page asked for cannot be done; `str()` says why in one sentence."""


class Source(Protocol):
    """What the pump asks, some dozens of times a second. Nothing in here waits."""

    generation: int
    """Grows whenever what was shown so far is void: after a jump within a recording."""

    def take(self) -> list[Message]:
        """What has come since the last call, oldest first."""
        ...

    def now_ns(self) -> int:
        """The car's clock, as its messages are stamped by."""
        ...

    def say(self, text: str) -> None:
        """Tell the car. Raises `Refused`."""
        ...

    def control(self, do: str, value: Any) -> None:
        """Pause, resume, step, restart, seek or change the speed. Raises `Refused`."""
        ...

    def state(self) -> dict[str, Any]:
        """What a page must know of the source: its kind, what it can do, where it is."""
        ...


class BusSource:
    """The running car."""

    kind: Literal["live"] = "live"

    def __init__(self, bus: Bus, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._bus, self._clock_ns = bus, clock_ns
        self.generation = 0
        self._obeys = self._paused = False
        self._commands = bus.subscribe_bytes(topics.COMMAND)
        self._others = tuple(bus.subscribe(topic) for topic in topics.TOPICS if topic is not topics.COMMAND)

    def take(self) -> list[Message]:
        now_ns = self._clock_ns()
        messages: list[Message] = []
        for number, payload in enumerate(self._commands.take()):
            try:
                messages.append(decode_command(payload, fallback_id=now_ns // 1000 + number, epoch=0, now_ns=now_ns))
            except Fault:  # the slow node answers it; here it is nothing to show
                continue
        for ring in self._others:
            messages += ring.take()
        for message in messages:
            if isinstance(message, Status) and message.node == "sim":
                self._obeys = "paused" in message.metrics
                self._paused = bool(message.metrics.get("paused"))
        return messages

    def now_ns(self) -> int:
        return self._clock_ns()

    def say(self, text: str) -> None:
        command = Command(
            epoch=0, stamp_ns=self._clock_ns(), id=secrets.randbits(48), text=text.strip(), source="cockpit"
        )
        try:
            self._bus.publish(topics.COMMAND, command)
        except (Fault, UnicodeEncodeError) as error:
            raise Refused(f"This cannot be said: {error}.") from None

    def control(self, do: str, value: Any) -> None:
        if not self._obeys:
            raise Refused("The running simulator takes no orders.")
        if do not in ("pause", "resume", "step", "restart"):
            raise Refused("The simulator takes no such order.")
        world = _world(value) if do == "restart" and isinstance(value, dict) else {}
        self._bus.publish(topics.CONTROL, Control(epoch=0, stamp_ns=self._clock_ns(), do=do, **world))  # type: ignore[arg-type]

    def state(self) -> dict[str, Any]:
        can = ["say", "pause", "step", "restart"] if self._obeys else ["say"]
        return {"kind": self.kind, "can": can, "paused": self._paused, "scenarios": _scenarios() if self._obeys else []}


def _world(asked: dict[str, Any]) -> dict[str, Any]:
    """The road, seed and density of a restart, as far as named. Raises `Refused` where there is no such world."""
    world = {name: asked[name] for name in ("scenario", "seed", "density") if asked.get(name) is not None}
    scenario, seed, density = world.get("scenario", ""), world.get("seed", 0), world.get("density", 1.0)
    if scenario not in ("", *_scenarios()):
        raise Refused("There is no such road.")
    if not (isinstance(seed, int) and 0 <= seed < 2**31):
        raise Refused(f"A seed is a whole number from 0 to {2**31 - 1}.")
    if not isinstance(density, int | float):
        raise Refused("A density is a number.")
    try:
        _roads()[scenario or "highway"].varied((), density)
    except ValueError as error:
        raise Refused(f"There is no such traffic: {error}.") from None
    return world


@cache
def _roads() -> Mapping[str, Any]:
    from sim_node.scenarios import SCENARIOS  # here: a recording needs nothing of it

    return SCENARIOS


def _scenarios() -> list[str]:
    return list(_roads())


class Recorded(Protocol):
    """What is needed of a recording, as `deploy.record.reader.open_recording` gives it. Times in ns since 1970."""

    start_ns: int
    end_ns: int
    clock_offset_ns: int
    """Between these times and CLOCK_MONOTONIC, by which the messages are stamped."""

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[tuple[int, str, Message]]: ...


SPEEDS = (0.1, 8.0)
FAST = ("observation", "action", "status")
"""Topics of which only the newest counts; of the others everything that was before the playhead is shown."""
BEFORE_NS = 2 * NS
"""So much of the fast topics before a jump's goal makes the picture whole."""
TAKE_MOST = 2000
"""Messages at a time, so that the pages are served in between."""


class RecordingSource:
    """A recording, played at a chosen speed from a playhead that can be moved."""

    kind: Literal["replay"] = "replay"

    def __init__(self, recording: Recorded, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._recording, self._clock_ns = recording, clock_ns
        self.generation = 0
        self.paused = False
        self.speed = 1.0
        names = [topic.name for topic in topics.TOPICS if topic.name not in FAST]
        self._said = [(at_ns, message) for at_ns, _, message in recording.messages(names)]
        first = next(recording.messages(("observation",)), None)
        self._start_ns = recording.start_ns if first is None else first[0]  # before it there is nothing to see
        self._at_ns = self._start_ns
        self._looked_ns = clock_ns()
        self._ready: list[Message] = []
        self._rest: Iterator[tuple[int, str, Message]] = iter(())
        self._next: tuple[int, str, Message] | None = None
        self._jump(self._start_ns)

    def take(self) -> list[Message]:
        looked_ns, self._looked_ns = self._looked_ns, self._clock_ns()
        if not self.paused:
            self._at_ns += round((self._looked_ns - looked_ns) * self.speed)
        taken, self._ready = self._ready, []
        while len(taken) < TAKE_MOST and self._next is not None and self._next[0] <= self._at_ns:
            taken.append(self._next[2])
            self._next = next(self._rest, None)
        if self._next is None and self._at_ns >= self._recording.end_ns:
            self._at_ns, self.paused = self._recording.end_ns, True
        return taken

    def now_ns(self) -> int:
        return self._at_ns - self._recording.clock_offset_ns

    def say(self, text: str) -> None:
        raise Refused("A recording does not listen.")

    def control(self, do: str, value: Any) -> None:
        match do, value:
            case "pause", None:
                self.paused = True
            case "resume", None:
                if self._at_ns >= self._recording.end_ns:
                    self._jump(self._start_ns)
                self.paused = False
            case "step", None:
                self.paused = True
                self._step()
            case "speed", int() | float() if SPEEDS[0] <= value <= SPEEDS[1]:
                self.speed = float(value)
            case "seek", int() | float() if math.isfinite(value):
                goal_ns = self._start_ns + round(value * NS)
                self._jump(min(max(goal_ns, self._start_ns), self._recording.end_ns))
            case _:
                raise Refused("A recording takes no such order.")

    def state(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "can": ["pause", "step", "speed", "seek"],
            "paused": self.paused,
            "speed": self.speed,
            "position": round((self._at_ns - self._start_ns) / NS, 2),
            "length": round((self._recording.end_ns - self._start_ns) / NS, 2),
        }

    def _jump(self, goal_ns: int) -> None:
        """To `goal_ns`, with the picture as it was: all that was said before, and the fast topics' last moments."""
        self.generation += 1
        self._at_ns = goal_ns
        fast = [(at_ns, m) for at_ns, _, m in self._recording.messages(FAST, goal_ns - BEFORE_NS, goal_ns)]
        said = [(at_ns, m) for at_ns, m in self._said if at_ns < goal_ns]
        self._ready = [message for _, message in merge(said, fast, key=lambda item: item[0])]
        self._rest = self._recording.messages(None, goal_ns)
        self._next = next(self._rest, None)

    def _step(self) -> None:
        """On to just before the observation after the next: a whole tick, with what answered it."""
        observations = 0
        while self._next is not None and len(self._ready) < TAKE_MOST:
            observations += isinstance(self._next[2], Observation)
            if observations > 1:
                break
            self._at_ns = self._next[0]
            self._ready.append(self._next[2])
            self._next = next(self._rest, None)
