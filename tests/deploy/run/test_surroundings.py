"""What the environment's variables and the command line may say: nonsense ends with one line that names the fix."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from deploy.cli.app import app
from deploy.cli.bounded import MOST, BoundedCommand, Commands
from deploy.cli.options import sayable
from deploy.run.model_choice import choose_model
from deploy.run.processes import Model, ModelOptions
from schemas.runtime.errors import SAID_CHARS, ConfigError
from slow_node.llm.endpoint import MODEL_CHARS, URL_CHARS, endpoint_url, ollama_url

VARIABLES = ("OPENAI_API_KEY", "OPENAI_BASE_URL", "OPENAI_MODEL", "OLLAMA_HOST", "FASTSLOW_GGUF")
HERE = "http://127.0.0.1:9/v1"
ODD = (
    "http://[::1", "host:99999", "\x1b[31mred", "a b c", "x" * 100_000, "http://x:abc", "http://\u202ex", "http://x/\nfoo",
    "http://me:secret@x/v1", "\udce9", "ftp://x", "\t\t", "http://", "\x7f", "\u0085",
)  # fmt: skip


def chosen(env: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> Model | str:
    """The model, or the line that says why there is none."""
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)
    for name, value in env.items():
        monkeypatch.setenv(name, value)
    try:
        return choose_model(ModelOptions())
    except ConfigError as error:
        return str(error)


@pytest.mark.parametrize("value", ODD, ids=range(len(ODD)))
@pytest.mark.parametrize("variable", VARIABLES)
def test_an_odd_value_of_a_variable_is_refused_in_one_line_or_means_something(
    variable: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    also = {"OPENAI_BASE_URL": HERE} if variable == "OPENAI_MODEL" else {"OPENAI_MODEL": "m"}
    found = chosen({**also, variable: value}, monkeypatch)
    if isinstance(found, str):
        assert found.isprintable()
        assert len(found) <= 300
        assert "secret" not in found or variable == "FASTSLOW_GGUF"  # a path is no secret
    else:
        assert (found.base_url + found.name).isprintable()
        assert len(found.base_url) <= URL_CHARS + 20
        assert len(found.name) <= MODEL_CHARS


@pytest.mark.parametrize("variable", ["OPENAI_BASE_URL", "OLLAMA_HOST", "OPENAI_API_KEY", "OPENAI_MODEL"])
def test_a_value_of_100_000_characters_names_its_variable_or_how_it_must_look(
    variable: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = chosen({"OPENAI_MODEL": "m", variable: "x" * 100_000}, monkeypatch)
    assert isinstance(said, str)
    assert variable in said or "must look like" in said


@given(st.text(max_size=60))
def test_any_text_is_an_address_on_one_line_or_refused(text: str) -> None:
    for read in (endpoint_url, ollama_url):
        try:
            url = read(text)
        except ValueError:
            continue
        assert url.startswith(("http://", "https://"))
        assert url.isprintable()


@given(st.text(max_size=3000))
def test_what_a_user_is_told_is_one_line_whatever_it_quotes(text: str) -> None:
    said = str(ConfigError(text))
    assert len(said) <= SAID_CHARS
    assert len(said.splitlines()) <= 1


def test_a_pipe_in_the_place_of_weights_is_refused_and_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe.gguf")
    said = chosen({"FASTSLOW_GGUF": str(tmp_path / "pipe.gguf")}, monkeypatch)
    assert isinstance(said, str)
    assert "GGUF" in said


def commands_of(command: Any) -> Iterator[Any]:
    """All that do something."""
    below = getattr(command, "commands", {})
    yield from (found for one in below.values() for found in commands_of(one)) if below else (command,)


def test_every_command_of_the_command_line_bounds_its_numbers() -> None:
    found = list(commands_of(typer.main.get_command(app)))
    assert len(found) > 15
    assert all(isinstance(command, BoundedCommand) for command in found)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e400", str(MOST + 1), f"-{10**30}", "", "0x10", "7 8"])
@pytest.mark.parametrize("option", ["--count", "--seconds", "--several"])
def test_no_command_takes_a_number_that_is_none_or_far_too_large(option: str, value: str) -> None:
    small = Commands()

    @small.command()
    def run(
        count: int = 0, seconds: Annotated[float, typer.Option(min=1.0)] = 1.0, several: list[float] | None = None
    ) -> None:
        raise AssertionError("it ran")

    result = CliRunner().invoke(small, [f"{option}={value}"])
    assert (result.exit_code, type(result.exception)) == (2, SystemExit)
    assert option in result.output


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.text(max_size=40))
def test_any_model_name_is_kept_or_refused(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    if "\0" in name or any(0xD800 <= ord(c) <= 0xDFFF for c in name):
        return  # no environment holds these
    found = chosen({"OPENAI_BASE_URL": HERE, "OPENAI_MODEL": name or "m"}, monkeypatch)
    assert isinstance(found, str) or found.name == (name or "m").strip()


@pytest.mark.parametrize("words", [["run", "--say"], ["say"]])
@pytest.mark.parametrize("text", ["x" * 5000, "\udcff", "ü" * 3000], ids=["long", "no text", "long in bytes"])
def test_what_cannot_be_said_is_refused_before_anybody_drives(words: list[str], text: str) -> None:
    result = CliRunner().invoke(app, [*words, text])
    assert (result.exit_code, type(result.exception)) == (2, SystemExit)


def test_words_that_a_locale_without_letters_hands_over_in_bytes_are_read_as_they_were_written() -> None:
    assert sayable("schöner".encode().decode("ascii", "surrogateescape"), "--say") == "schöner"
    assert sayable("schöner", "--say") == "schöner"
