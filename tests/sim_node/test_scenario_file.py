"""A scenario from a file is a road that differs from another in what the file says."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim_node.scenario_file import find_scenario, scenario_of
from sim_node.scenarios import SCENARIOS


def written(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_file_that_says_nothing_is_its_base_under_its_own_name(name: str, tmp_path: Path) -> None:
    said = f'base = "{name}"\nname = "{name}"\ndescription = "{SCENARIOS[name].description}"\n'
    assert find_scenario(written(tmp_path, said)) == SCENARIOS[name]


def test_what_a_file_says_replaces_a_list_and_is_merged_into_a_table(tmp_path: Path) -> None:
    mine = find_scenario(written(tmp_path, 'base = "merge"\nduration_s = 9\n[ego]\nspeed_mps = [10, 11]\n'))
    assert (mine.name, mine.duration_s, mine.ego.speed_mps) == ("mine", 9.0, (10.0, 11.0))
    assert mine.ego.x_m == SCENARIOS["merge"].ego.x_m


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('base = "moon"', "moon"),
        ('base = "merge"\nspeed = 3', "no field speed"),
        ('base = "merge"\n[ego]\nsped_mps = [1, 2]', "no field ego.sped_mps"),
        ('base = "merge"\nduration_s = "long"', "duration_s"),
        ("duration_s = 3.0", "missing required field"),
        ("base =", "Invalid value"),
    ],
)
def test_a_file_that_is_no_scenario_is_refused_with_the_reason(text: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=why):
        find_scenario(written(tmp_path, text))


def test_what_is_neither_a_name_nor_a_file_is_refused_with_the_choice(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="highway"):
        find_scenario("moon")
    with pytest.raises(ValueError, match="there is no file"):
        find_scenario(str(tmp_path / "none.toml"))


@pytest.mark.parametrize(
    "text",
    [
        "base = ['x']",
        "base = 5",
        "ego = " + "[" * 50_000,
        "duration_s = -1",
        "duration_s = inf",
        "duration_s = nan",
        "duration_s = 1e300",
        "duration_s = " + "9" * 5000,
        "name = ''",
        "name = '" + "x" * 2000 + "'",
        "sight_m = 0",
        "ego = 5",
        "[ego]\nspeed_mps = [30.0, 20.0]",
        "[ego]\nspeed_mps = [-5.0, 20.0]",
        "[ego]\nspeed_mps = []",
        "[ego]\nspeed_ceiling_mps = 1e5",
        "lanes = [" + "1," * 5000 + "]",
    ],
    ids=lambda text: text[:24],
)
def test_a_value_that_no_road_has_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ValueError, match=r"^scenario file x.toml: ") as told:
        scenario_of("x.toml", text if text.startswith("base") else f'base = "highway"\n{text}')
    assert str(told.value).isprintable()
    assert len(str(told.value)) < 400


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_road_of_ours_is_within_the_bounds_of_a_file(name: str) -> None:
    assert scenario_of("x.toml", f'base = "{name}"').lanes == SCENARIOS[name].lanes
