"""A recorded run as pictures: one for every tick of the road, with what was said and what became of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import repeat

from deploy.film.story import Story
from deploy.film.writer import Picture
from deploy.record.moments import Moment, moments
from deploy.record.reader import NotARecordingError, Recording
from schemas.runtime.process import ConfigError


def pictures(recording: Recording, from_s: float = 0.0, to_s: float = math.inf) -> Iterator[Picture]:
    """Pictures of what was recorded from `from_s` to `to_s`, seconds since the first tick, at the rate of the ticks.

    A world that stood still is shown once. Before ticks that are not recorded the last one stays for as long as they
    took. Raises `ConfigError` where the file is damaged.
    """
    story = Story()
    last: tuple[int, int, Picture] | None = None
    for moment in _until_damaged(recording):
        if moment.at_s > to_s:
            return
        for message in moment.heard:
            story.hear(message)
        if moment.at_s < from_s:
            continue
        epoch, tick = moment.observation.epoch, moment.observation.tick
        if last is not None and last[0] == epoch:
            yield from repeat(last[2], tick - last[1] - 1)
        drawn = story.draw(moment.observation, moment.action)
        last = epoch, tick, drawn
        yield drawn


def _until_damaged(recording: Recording) -> Iterator[Moment]:
    at_s = 0.0
    try:
        for moment in moments(recording):
            at_s = moment.at_s
            yield moment
    except NotARecordingError as error:
        raise ConfigError(f"{error}: film what is before that with --to {math.floor(at_s - 0.1)}") from None
