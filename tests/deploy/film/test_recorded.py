"""Films of recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from deploy.cli.app import app
from deploy.film.recorded import pictures
from deploy.film.writer import write_film
from deploy.record.container import scan
from deploy.record.moments import length_s, moments
from deploy.record.reader import open_recording
from schemas.runtime.process import ConfigError
from tests.recordings import driven, without, write


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of three seconds, in which somebody asks for an overtake at 0.4 s."""
    return write(tmp_path_factory.mktemp("run") / "a.mcap", driven(3.0))


def told(*arguments: str) -> tuple[int, str]:
    """Exit code and what is said of a film that cannot be made."""
    result = CliRunner().invoke(app, ["video", *arguments])
    assert "Traceback" not in result.output
    return result.exit_code, result.stderr


def test_a_film_has_a_picture_for_every_recorded_tick_with_the_mask_and_what_was_said(recording):
    film = list(pictures(open_recording(recording)))
    assert len(film) == 45
    quiet, asked = film[2], film[10]
    assert (quiet[:50, 230:] != asked[:50, 230:]).any()  # the words and the directive
    assert all(picture[-60:-30, 20:800].max() > 200 for picture in film)  # the five actions


def test_an_action_that_was_recorded_before_its_observation_is_still_its_answer(recording, tmp_path):
    messages = list(driven(1.0))
    for k in range(0, len(messages) - 1):
        if type(messages[k + 1]).__name__ == "Action":
            messages[k], messages[k + 1] = messages[k + 1], messages[k]
    early = open_recording(write(tmp_path / "early.mcap", messages))
    assert all(moment.action is not None for moment in moments(early))
    straight = pictures(open_recording(recording))
    assert all((a == b).all() for a, b in zip(list(pictures(early))[:6], straight, strict=False))


def test_a_part_of_a_recording_shows_what_the_whole_shows_then(recording):
    whole = list(pictures(open_recording(recording)))
    part = list(pictures(open_recording(recording), 0.99, 2.01))
    assert len(part) == 16
    assert all((a == b).all() for a, b in zip(part, whole[15:31], strict=True))


def test_over_ticks_that_are_missing_the_picture_before_them_stays(tmp_path):
    gap = range(10, 20)
    film = list(pictures(open_recording(write(tmp_path / "a.mcap", without(driven(2.0), gap)))))
    assert len(film) == 30
    assert all((film[k] == film[9]).all() for k in gap)
    assert (film[20] != film[9]).any()


def test_an_interrupted_recording_films_as_far_as_it_goes(tmp_path):
    whole = write(tmp_path / "whole.mcap", driven(3.0), finish=False).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[:-200])
    result = CliRunner().invoke(app, ["video", str(tmp_path / "cut.mcap"), "-o", str(tmp_path / "x.gif")])
    assert (result.exit_code, "cut off" in result.stderr) == (0, True)
    assert 1.5 < length_s(open_recording(tmp_path / "cut.mcap")) < 2.5
    assert (tmp_path / "x.gif").read_bytes().startswith(b"GIF89a")


def test_a_damaged_recording_is_told_in_a_line_and_leaves_no_half_film(recording, tmp_path):
    data = bytearray(recording.read_bytes())
    with recording.open("rb") as file:
        part = scan(file).parts[2].index
    data[part.chunk_start_offset + part.chunk_length - 100] ^= 0x10
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    code, said = told(str(bad), "-o", str(tmp_path / "x.gif"))
    assert (code, f"{bad} is damaged at byte {part.chunk_start_offset}" in said) == (78, True)
    assert list(tmp_path.iterdir()) == [bad]
    before = said.split("--to ")[1].strip()
    assert int(before) >= 1
    assert told(str(bad), "--to", before, "-o", str(tmp_path / "x.gif"))[0] == 0


@pytest.mark.parametrize("chunk", [0, 1])
@pytest.mark.parametrize("at", range(9, 57, 4))
def test_a_bit_that_is_flipped_in_a_chunk_s_head_is_told_in_a_line(recording, tmp_path, chunk, at):
    data = bytearray(recording.read_bytes())
    with recording.open("rb") as file:
        start = scan(file).parts[chunk].index.chunk_start_offset
    data[start + at] ^= 0x40
    (tmp_path / "bad.mcap").write_bytes(data)
    part = ("--from", "0.9", "--to", "1.2")  # of both chunks
    code, said = told(str(tmp_path / "bad.mcap"), *part, "-o", str(tmp_path / "x.gif"))
    assert (code in (0, 78), "Invalid argument" in said) == (True, False)


def test_a_foreign_or_empty_file_is_told_in_a_line(tmp_path):
    (tmp_path / "diary.mcap").write_bytes(b"my diary, not a recording")
    write(tmp_path / "empty.mcap", [])
    film = ("-o", str(tmp_path / "x.gif"))
    assert "is not an MCAP file" in told(str(tmp_path / "diary.mcap"), *film)[1]
    assert "holds no drive" in told(str(tmp_path / "empty.mcap"), *film)[1]
    assert told(str(tmp_path / "none.mcap"), *film)[0] == 78


@pytest.mark.parametrize(
    ("arguments", "option"),
    [(("--seed", "3"), "--seed"), (("--say", "faster"), "--say"), (("--duration", "2"), "--duration")],
)
def test_a_recording_has_its_own_road_driver_and_words(recording, tmp_path, arguments, option):
    code, said = told(str(recording), *arguments, "-o", str(tmp_path / "x.gif"))
    assert (code, option in said, "leave it out" in said) == (2, True, True)


def test_only_a_recording_has_a_part_to_choose(tmp_path):
    code, said = told("--from", "3", "-o", str(tmp_path / "x.gif"))
    assert (code, "name its file" in said) == (2, True)


def test_a_beginning_after_the_end_is_told_with_the_length(recording, tmp_path):
    code, said = told(str(recording), "--from", "60", "-o", str(tmp_path / "x.gif"))
    assert (code, "before 2.9 s" in said) == (78, True)


def test_a_film_that_fails_leaves_the_older_one_alone(tmp_path):
    def failing():
        yield np.zeros((40, 80, 3), np.uint8)
        raise ConfigError("no more")

    (tmp_path / "x.gif").write_bytes(b"the older one")
    with pytest.raises(ConfigError, match="no more"):
        write_film(tmp_path / "x.gif", failing())
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"the older one"]
