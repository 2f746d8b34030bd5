"""Whether the supervisor hears at all. When nobody is heard, that may be its own fault, not everybody's death."""

from __future__ import annotations

import os
from collections.abc import Callable

from schemas.runtime.bus import Bus
from schemas.wire.messages import Status
from schemas.wire.topics import STATUS

NAME = "supervisor"
SPEAK_S = 0.5
DEAF_S = 1.25
"""Shorter than any node may be silent, so that deafness is known before somebody is taken for dead."""


class Hearing:
    """Speaks on the bus by a link of its own, as a node does, and listens for its own voice."""

    def __init__(self, voice: Bus, notice: Callable[[str], None], now_s: float) -> None:
        """notice: told once when it hears nothing any more, and when it does again."""
        self._voice, self._notice = voice, notice
        self._spoke_s, self._heard_s = now_s - SPEAK_S, now_s
        self._seq, self._deaf = 0, False

    def heard(self, status: Status, now_s: float) -> None:
        """A heartbeat has come, of whomever."""
        if status.node == NAME and status.pid == os.getpid():
            self._heard_s = now_s

    def hears(self, now_s: float) -> bool:
        """Speak if it is time to. Whether what was said in the last second has come back; call it often."""
        if now_s - self._spoke_s > 1.0:  # we slept ourselves
            self._heard_s += now_s - self._spoke_s
        if now_s - self._spoke_s >= SPEAK_S:
            self._spoke_s, self._seq = now_s, self._seq + 1
            beat = Status(
                epoch=0, stamp_ns=round(now_s * 1e9), node=NAME, pid=os.getpid(), seq=self._seq, state="ready"
            )
            self._voice.publish(STATUS, beat)
        deaf = now_s - self._heard_s > DEAF_S
        if deaf != self._deaf:
            self._deaf = deaf
            self._notice(
                "the supervisor hears nobody, itself included: it takes nobody for dead until it does"
                if deaf
                else "the supervisor hears again"
            )
        return not deaf
