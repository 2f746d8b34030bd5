"""The supervisor tells its own deafness from the death of the others."""

from __future__ import annotations

from deploy.run.hearing import DEAF_S, Hearing
from schemas.runtime.local_bus import LocalBus
from schemas.wire import topics


class Ear:
    """A supervisor's hearing on a bus that can be cut off."""

    def __init__(self) -> None:
        self.bus, self.said, self.now_s, self.cut_off = LocalBus(), list[str](), 100.0, False
        self.beats = self.bus.subscribe(topics.STATUS)
        self.hearing = Hearing(self.bus, self.said.append, self.now_s)

    def after(self, seconds: float) -> bool:
        """Whether it still hears, so much later."""
        end_s, hears = self.now_s + seconds, True
        while self.now_s < end_s:
            self.now_s += 0.05
            for beat in self.beats.take():
                if not self.cut_off:
                    self.hearing.heard(beat, self.now_s)
            hears = self.hearing.hears(self.now_s)
        return hears


def test_it_hears_as_long_as_its_own_voice_comes_back() -> None:
    ear = Ear()
    assert ear.after(10.0)
    assert ear.said == []


def test_it_is_deaf_before_any_node_would_count_as_silent_and_says_so_once() -> None:
    ear = Ear()
    ear.after(3.0)
    ear.cut_off = True
    assert not ear.after(DEAF_S + 0.1)
    assert not ear.after(20.0)
    assert len(ear.said) == 1
    assert "hears nobody, itself included" in ear.said[0]
    ear.cut_off = False
    assert ear.after(2.0)
    assert ear.said[1:] == ["the supervisor hears again"]


def test_after_a_sleep_of_its_own_it_is_not_deaf() -> None:
    ear = Ear()
    ear.after(3.0)
    ear.now_s += 60.0
    assert ear.hearing.hears(ear.now_s)
    assert ear.after(5.0)
    assert ear.said == []
