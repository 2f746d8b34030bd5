"""From one picture to many pages: each gets the newest frame when it is ready for one, and every note.

A page confirms what it has received. One that does not, because it is frozen or hostile, has at most `IN_FLIGHT`
messages on their way to it, and costs nothing more: its frames are counted as dropped.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec

from deploy.cockpit.picture import Picture
from deploy.cockpit.sources import Source
from schemas.runtime.clock import NS

IN_FLIGHT = 3
MAX_BYTES = 64 * 1024
"""Notes beyond this wait for the next message."""
IDLE_NS = NS // 5
"""Without anything new a frame goes out this often: the ages of heartbeats are worth seeing."""
LEAST_NS = NS // 22
"""Between two frames: a recording played fast has more ticks than an eye."""
POLL_S = 0.015


@dataclass(eq=False)
class Page:
    """One browser's connection."""

    wake: asyncio.Event = field(default_factory=asyncio.Event)
    in_flight: int = 0
    frame: int = 0
    """Number of the last frame that was sent."""
    note: int = 0
    generation: int = -1
    road: int = -1
    dropped: int = 0

    def confirm(self) -> None:
        """The page has received a message."""
        self.in_flight = max(0, self.in_flight - 1)
        self.wake.set()


class Hub:
    """Polls the source, keeps the picture, hands out messages."""

    def __init__(self, source: Source, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.source, self._clock_ns = source, clock_ns
        self.picture = Picture()
        self.pages: set[Page] = set()
        self.frames = 0
        self.dropped = 0
        self.session = secrets.token_hex(4)
        """Of this process: a page that comes back to another one forgets what it knew."""
        self._generation = source.generation
        self._frame = b"{}"
        self._road = b"null"
        self._road_version = 0
        self._composed_ns = 0
        self._tick: tuple[int, int] | None = None
        self._told: dict[str, Any] = {}
        self._state = b"{}"

    def metrics(self) -> dict[str, float]:
        """For the heartbeat."""
        return {"pages": float(len(self.pages)), "frames": float(self.frames), "dropped": float(self.dropped)}

    async def run(self) -> None:
        """Until cancelled."""
        while True:
            self.poll()
            await asyncio.sleep(POLL_S)

    def poll(self) -> None:
        """One round: what is new goes into the picture, and a new frame out, if there is anything to see."""
        messages = self.source.take()
        if self.source.generation != self._generation:
            self._generation = self.source.generation
            self.picture, self._road_version = Picture(), 0
        number = self._noted()
        for message in messages:
            self.picture.take(message)
        self.picture.watch(self.source.now_ns())
        state = self.source.state()
        told = {name: value for name, value in state.items() if name != "position"}
        seen = self.picture.observation
        tick = None if seen is None else (seen.epoch, seen.tick)
        since_ns = self._clock_ns() - self._composed_ns
        due = since_ns > IDLE_NS or (tick != self._tick and since_ns >= LEAST_NS)
        if due or told != self._told:
            self._told, self._tick = told, tick
            self._compose(state)
        elif self._noted() != number:
            self._wake()

    def _noted(self) -> int:
        return max((store[-1].number for store in (self.picture.notes, self.picture.thoughts) if store), default=0)

    def _compose(self, state: dict[str, Any]) -> None:
        self._composed_ns, self._state = self._clock_ns(), msgspec.json.encode(state)
        self.frames += 1
        for page in self.pages:
            if page.frame < self.frames - 1 and page.frame:
                page.dropped += 1
                self.dropped += 1
        self._frame = msgspec.json.encode(self.picture.frame(self.source.now_ns()))
        if self.picture.road_version != self._road_version:
            self._road_version = self.picture.road_version
            self._road = msgspec.json.encode(self.picture.road())
        self._wake()

    def _wake(self) -> None:
        for page in self.pages:
            page.wake.set()

    def message_for(self, page: Page) -> bytes | None:
        """The next message of a page, which is then on its way; None while it is not ready or there is nothing."""
        if page.in_flight >= IN_FLIGHT:
            return None
        if page.generation != self._generation:
            page.generation, page.note, page.road = self._generation, 0, -1
        notes: list[bytes] = []
        size = 0
        for note in self.picture.since(page.note):
            size += len(note.body)
            if notes and size > MAX_BYTES:
                page.wake.set()
                break
            notes.append(note.body)
            page.note = note.number
        if page.frame == self.frames and not notes:
            return None
        road = page.road != self._road_version
        parts = [
            b'{"session":"%s-%d","dropped":%d,"source":' % (self.session.encode(), self._generation, page.dropped),
            self._state,
            b',"frame":',
            self._frame,
            b',"road":' + self._road if road else b"",
            b',"notes":[',
            b",".join(notes),
            b"]}",
        ]
        page.frame, page.road = self.frames, self._road_version
        page.in_flight += 1
        return b"".join(parts)
