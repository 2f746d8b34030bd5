"""Films of lock-step drives."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.film.drive import default_node, drive, worded
from deploy.film.writer import durations_ms, write_film
from schemas.runtime.process import ConfigError
from schemas.wire.messages import Directive, Event, Observation
from sim_node.config import SimConfig

PICTURES = [np.full((40, 80, 3), 6 * k, np.uint8) for k in range(30)]


def test_a_drive_shows_a_shot_for_every_tick_and_the_directive_from_when_it_is_given():
    def ask(observation: Observation, now_ns: int) -> Directive | None:
        if observation.tick != 5:
            return None
        return Directive(epoch=1, stamp_ns=now_ns, id=1, command_id=1, scene_tick=5, target_speed_mps=20.0)

    shots = list(drive(default_node(), SimConfig(scenario="highway", seed=1000), 1.0, ask))
    assert [shot.observation.tick for shot in shots] == list(range(15))
    assert [shot.directive is not None for shot in shots] == [k >= 5 for k in range(15)]
    assert all(shot.action.answers_tick == shot.observation.tick for shot in shots)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_a_film_lasts_as_long_as_the_drive(tmp_path, suffix):
    image = pytest.importorskip("PIL.Image")
    assert write_film(tmp_path / f"x{suffix}", iter(PICTURES)) == 30
    with image.open(tmp_path / f"x{suffix}") as film:
        total = 0
        for k in range(film.n_frames):
            film.seek(k)
            film.load()
            total += film.info["duration"]
    assert total == pytest.approx(2000, abs=10)


def test_an_mp4_has_every_picture_at_the_rate_of_the_drive(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    write_film(tmp_path / "x.mp4", iter(PICTURES), hz=15)
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "x.mp4")) == (30, pytest.approx(2.0, abs=0.01))


@pytest.mark.parametrize("hz", [15, 5, 1, 60])
def test_hundredths_of_a_second_add_up_to_real_time(hz):
    assert sum(durations_ms(120, hz, ".gif")) == pytest.approx(120_000 / hz, abs=5)


def test_an_unknown_suffix_is_an_error_that_names_the_known_ones(tmp_path):
    with pytest.raises(ConfigError, match=r"\.gif, \.webp, \.mp4"):
        write_film(tmp_path / "x.avi", iter(PICTURES))


def test_a_drive_without_a_picture_is_an_error(tmp_path):
    with pytest.raises(ConfigError, match="nothing to show"):
        write_film(tmp_path / "x.gif", iter(()))


def test_an_event_is_told_with_its_reason_and_vehicle():
    event = Event(epoch=1, stamp_ns=0, kind="delayed", node="fast", tick=3, rule="oncoming traffic", vehicle=4)
    assert worded(event) == "delayed: oncoming traffic (car 4)"
