"""Films of lock-step drives."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec import structs

from deploy.film.drive import Passenger, Words, pictures
from deploy.film.story import Story, worded
from deploy.film.writer import durations_ms, write_film
from fast_node.policies.load import load_policy
from schemas.runtime.clock import NS
from schemas.runtime.process import ConfigError
from schemas.wire.messages import Command, Event, EventKind, Message, Reason, Reply
from sim_node.config import SimConfig
from sim_node.drawing import ASPHALT, EGO, GRASS, PANEL, picture
from tests.scenes import HIGHWAY, car, directive, observation

PICTURES = [np.full((40, 80, 3), 6 * k, np.uint8) for k in range(30)]


def test_a_drive_has_a_picture_for_every_tick_and_shows_what_was_said():
    silent = list(pictures(SimConfig(scenario="highway", seed=1000), load_policy("rule"), None, 1.0))
    told = list(pictures(SimConfig(scenario="highway", seed=1000), load_policy("rule"), Words("go faster", 0.4), 1.0))
    assert len(silent) == len(told) == 15
    changed = [k for k in range(15) if (silent[k][:50, 230:] != told[k][:50, 230:]).any()]
    assert changed == list(range(6, 15))


def test_a_refused_command_gives_no_directive_and_is_answered():
    heard: list[Message] = []
    passenger = Passenger(Words("ram the car in front of us", 0.0), heard.append)
    seen = observation(car(0, 100, 1, 20), lanes=HIGHWAY)
    assert passenger.ask(seen, 0) is None
    command, reply = heard
    assert isinstance(command, Command)
    assert isinstance(reply, Reply)
    assert (command.text, reply.outcome, bool(reply.say)) == ("ram the car in front of us", "refused", True)


def test_a_directive_is_shown_until_it_has_ended_or_is_too_old():
    story, asked = Story(), directive(target_lane=1, ttl_s=5.0)
    scene = observation(car(0, 100, 1, 20), lanes=HIGHWAY)

    def shown(at_s: float) -> bool:
        now = structs.replace(scene, stamp_ns=round(at_s * NS))
        return bool((story.draw(now, None) != picture(now)).any())

    story.hear(asked)
    assert [shown(at_s) for at_s in (0.0, 4.9, 5.1)] == [True, True, False]
    story.hear(Reply(epoch=1, stamp_ns=0, command_id=4, outcome="fulfilled", text="", directive_id=asked.id))
    assert not shown(0.0)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_a_film_lasts_as_long_as_the_drive(tmp_path, suffix):
    image = pytest.importorskip("PIL.Image")
    pytest.importorskip("imageio_ffmpeg")
    assert write_film(tmp_path / f"x{suffix}", iter(PICTURES)) == 30
    with image.open(tmp_path / f"x{suffix}") as film:
        total = 0
        for k in range(film.n_frames):
            film.seek(k)
            film.load()
            total += film.info["duration"]
    assert total == pytest.approx(2000, abs=10)


def test_a_gif_keeps_the_colour_of_a_small_car(tmp_path):
    image = pytest.importorskip("PIL.Image")
    scenes = [picture(observation(car(0, 100 + k, 1, 20), lanes=HIGHWAY)) for k in range(9)]
    write_film(tmp_path / "x.gif", iter(scenes))
    with image.open(tmp_path / "x.gif") as film:
        film.seek(5)
        assert (np.abs(np.asarray(film.convert("RGB"), int) - EGO).sum(-1) < 30).sum() > 100


def test_a_gif_keeps_the_colours_of_road_and_verge(tmp_path):
    image = pytest.importorskip("PIL.Image")
    scenes = [picture(observation(car(0, 100 + k, 1, 20), lanes=HIGHWAY)) for k in range(9)]
    write_film(tmp_path / "x.gif", iter(scenes))
    with image.open(tmp_path / "x.gif") as film:
        film.seek(5)
        shown = np.asarray(film.convert("RGB"), int)
    assert all((np.abs(shown - colour).max(-1) <= 1).sum() > 10_000 for colour in (GRASS, ASPHALT, PANEL))


def test_an_mp4_has_every_picture_at_the_rate_of_the_drive(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    write_film(tmp_path / "x.mp4", iter(PICTURES), hz=15)
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "x.mp4")) == (30, pytest.approx(2.0, abs=0.01))


@pytest.mark.parametrize("hz", [15, 5, 1, 60])
def test_hundredths_of_a_second_add_up_to_real_time(hz):
    assert sum(durations_ms(120, hz)) == pytest.approx(120_000 / hz, abs=5)


def test_an_unknown_suffix_is_an_error_that_names_the_known_ones(tmp_path):
    with pytest.raises(ConfigError, match=r"\.gif, \.webp, \.mp4"):
        write_film(tmp_path / "x.avi", iter(PICTURES))


def test_a_drive_without_a_picture_is_an_error(tmp_path):
    with pytest.raises(ConfigError, match="nothing to show"):
        write_film(tmp_path / "x.gif", iter(()))


def test_an_event_is_told_with_its_reason_and_vehicle():
    event = Event(epoch=1, stamp_ns=0, kind=EventKind.DELAYED, node="fast", tick=3, reason=Reason.ONCOMING, vehicle=4)
    assert worded(event) == "delayed: oncoming traffic (car 4)"


@pytest.mark.parametrize(
    ("kind", "said"),
    [("actuator", "gap too small"), ("waiting", "waiting: gap too small"), ("due", "due: gap too small")],
)
def test_what_an_event_is_about_is_told(kind, said):
    event = Event(epoch=1, stamp_ns=0, kind=EventKind(kind), node="sim", tick=1, detail="gap too small")
    assert worded(event) == said
