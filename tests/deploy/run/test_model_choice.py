"""Which language model is asked: what options and environment say, what an endpoint says, and what people are told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from deploy.run.doctor import doctor
from deploy.run.model_choice import KEY, choose_model
from deploy.run.processes import Model, ModelOptions, RunOptions, links_of, process_table
from schemas.runtime.process import CONFIG, FAILED, OK, ConfigError
from slow_node.config import TOKEN, SlowConfig
from slow_node.llm.endpoint import OPENAI_URL, ollama_url
from tests.faulty_server import FaultyServer, answer

VARIABLES = ("OPENAI_API_KEY", "OPENAI_BASE_URL", "OPENAI_MODEL", "OLLAMA_HOST", "FASTSLOW_GGUF")
HERE = "http://127.0.0.1:9/v1"


@pytest.fixture(autouse=True)
def _bare(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in VARIABLES:
        monkeypatch.delenv(name, raising=False)


def chosen(monkeypatch: pytest.MonkeyPatch, env: dict[str, str], **options: Any) -> Model:
    for name, value in env.items():
        monkeypatch.setenv(name, value)
    return choose_model(ModelOptions(**options))


CHOICES: dict[str, tuple[dict[str, str], dict[str, str], str, str]] = {
    "a key alone": ({"OPENAI_API_KEY": "k"}, {}, OPENAI_URL, "gpt-4o-mini"),
    "a URL without a key": ({"OPENAI_BASE_URL": HERE, "OPENAI_MODEL": "m"}, {}, HERE, "m"),
    "an option over the variable": ({"OPENAI_BASE_URL": "http://x/v1"}, {"base_url": HERE, "name": "o"}, HERE, "o"),
    "Ollama": ({"OLLAMA_HOST": "0.0.0.0", "OPENAI_MODEL": "m"}, {}, "http://127.0.0.1:11434/v1", "m"),
    "Ollama's address without brackets": (
        {"OLLAMA_HOST": "::1", "OPENAI_MODEL": "m"},
        {},
        "http://[::1]:11434/v1",
        "m",
    ),
    "a key before Ollama": (
        {"OLLAMA_HOST": "::1", "OPENAI_API_KEY": "k"},
        {},
        "https://api.openai.com/v1",
        "gpt-4o-mini",
    ),
    "a URL before a key": ({"OPENAI_API_KEY": "k", "OPENAI_BASE_URL": HERE, "OPENAI_MODEL": "m"}, {}, HERE, "m"),
}


@pytest.mark.parametrize(("env", "options", "url", "name"), CHOICES.values(), ids=CHOICES.keys())
def test_an_endpoint_is_asked_as_soon_as_something_names_it(
    env: dict[str, str], options: dict[str, str], url: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = chosen(monkeypatch, env, **options)
    assert (model.base_url, model.name, model.embedded) == (url, name, False)


def test_without_any_the_embedded_model_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    model = chosen(monkeypatch, {"OPENAI_API_KEY": "", "OPENAI_BASE_URL": "", "OLLAMA_HOST": ""})
    assert model.embedded
    assert "no word leaves this machine" in model.where


@pytest.mark.parametrize(
    ("variable", "url"),
    [
        ("127.0.0.1", "http://127.0.0.1:11434/v1"),
        ("0.0.0.0:8080", "http://127.0.0.1:8080/v1"),
        (":8080", "http://127.0.0.1:8080/v1"),
        ("http://box.lan", "http://box.lan:80/v1"),
        ("https://box.example", "https://box.example:443/v1"),
        ("[::1]:11434", "http://[::1]:11434/v1"),
        ("'gpu-box'", "http://gpu-box:11434/v1"),
    ],
)
def test_ollamas_variable_is_read_as_ollama_reads_it(variable: str, url: str) -> None:
    assert ollama_url(variable) == url


def test_an_endpoint_that_serves_one_model_need_not_be_told_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    with FaultyServer(answer(), models=("nomic-embed-text", "qwen3:8b")) as server:
        assert chosen(monkeypatch, {}, base_url=server.url).name == "qwen3:8b"


@pytest.mark.parametrize("models", [("qwen3:8b", "llama3.2"), (), None])
def test_where_nobody_says_which_model_is_meant_the_fix_is_named(
    models: tuple[str, ...] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    with FaultyServer(answer(), models=models) as server, pytest.raises(ConfigError, match="--model") as refused:
        chosen(monkeypatch, {}, base_url=server.url)
    assert all(name in str(refused.value) for name in models or ())


MISTAKES: dict[str, tuple[dict[str, str], dict[str, str], str]] = {
    "a port that is none": ({"OPENAI_BASE_URL": "http://127.0.0.1:port/v1"}, {}, "port 'port'"),
    "a password in the URL": ({"OPENAI_BASE_URL": "http://me:secret@x/v1"}, {}, "OPENAI_API_KEY"),
    "a key with an umlaut": ({"OPENAI_API_KEY": "secret-ü"}, {}, "OPENAI_API_KEY holds"),
    "a model without an endpoint": ({}, {"name": "gpt-5"}, "--base-url"),
    "an empty URL": ({}, {"base_url": ""}, "must look like"),
    "nobody there": ({}, {"base_url": HERE}, "cannot be reached"),
}


@pytest.mark.parametrize(("env", "options", "fix"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_is_told_with_its_fix_and_without_a_secret(
    env: dict[str, str], options: dict[str, str], fix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigError, match=fix) as refused:
        chosen(monkeypatch, env, **options)
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(
    ("url", "name", "words"),
    [
        ("https://api.openai.com/v1", "gpt-4o", "your words and the scene leave this machine"),
        ("http://192.168.0.7:8000/v1", "m", "your words and the scene leave this machine"),
        ("http://127.0.0.1:11434/v1", "qwen3:8b", "a server on this machine"),
        ("http://127.0.0.1:11434/v1", "kimi-k2.6:cloud", "leave this machine for Ollama's cloud"),
        ("http://127.0.0.1:11434/v1", "gpt-oss:120b-cloud", "leave this machine for Ollama's cloud"),
    ],
)
def test_people_are_told_the_model_and_whether_words_leave_the_machine(url: str, name: str, words: str) -> None:
    where = Model(base_url=url, name=name, embedded=False).where
    assert name in where
    assert words in where


def test_budget_and_tokens_reach_the_slow_node_and_the_key_reaches_no_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "secret-of-mine")
    monkeypatch.setenv("FASTSLOW_DATA", str(tmp_path))
    options = RunOptions(model=ModelOptions(budget_s=45.0, max_tokens=9000))
    rows = process_table(options, choose_model(options.model), links_of(options, tmp_path), tmp_path)
    slow = json.loads(next(row for row in rows if row.name == "slow").argv[-1])
    assert (slow["budget_s"], slow["max_tokens"]) == (45.0, 9000)
    assert "secret-of-mine" not in repr(rows)


@pytest.mark.parametrize("budget_s", [0.1, 301.0])
def test_a_budget_out_of_bounds_is_refused(budget_s: float) -> None:
    with pytest.raises(ValueError, match="budget_s"):
        SlowConfig(budget_s=budget_s)


def examined(capsys: pytest.CaptureFixture[str], **options: Any) -> dict[str, str]:
    """What `fastslow doctor` finds about the model."""
    code = doctor(port=1, as_json=True, model=ModelOptions(**options))
    checks: list[dict[str, str]] = json.loads(capsys.readouterr().out)["checks"]
    assert code == (FAILED if any(check["result"] == "fail" for check in checks) else OK)
    return next(check for check in checks if check["name"] == "model")


def test_doctor_asks_an_endpoint_one_word(capsys: pytest.CaptureFixture[str]) -> None:
    with FaultyServer(answer("ready"), models=("qwen3:8b",)) as server:
        found = examined(capsys, base_url=server.url)
        assert found["result"] == "ok"
        assert "answers 'ready'" in found["detail"]
        assert "one word" in server.bodies[0]["messages"][0]["content"]


def test_doctor_says_what_the_server_says(capsys: pytest.CaptureFixture[str]) -> None:
    missing: tuple[int, dict[str, str], bytes] = (
        404,
        {},
        b'{"error": "model \\"m\\" not found, try pulling it first"}',
    )
    with FaultyServer(missing) as server:
        found = examined(capsys, base_url=server.url, name="m")
    assert found["result"] == "fail"
    assert "try pulling it first" in found["detail"]


def test_a_run_ends_at_once_where_the_address_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from deploy.run.system import run_system

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FASTSLOW_DATA", str(tmp_path / "data"))
    assert run_system(RunOptions(port=0, model=ModelOptions(base_url="http://127.0.0.1:port"))) == CONFIG
    assert capsys.readouterr().err.count("\n") == 1


def test_only_the_slow_node_gets_the_key_and_only_the_model_and_it_the_token(tmp_path: Path) -> None:
    options = RunOptions(cockpit_port=0)
    cloud, embedded = (Model(base_url="http://127.0.0.1:1/v1", name="m", embedded=e, port=1) for e in (False, True))
    wanted = {"slow": {KEY}}, {"slow": {TOKEN}, "llm": {TOKEN}}
    for model, needs in zip((cloud, embedded), wanted, strict=True):
        rows = process_table(options, model, links_of(options, tmp_path), tmp_path)
        assert {row.name: {*row.secrets} & {KEY, TOKEN} for row in rows if {*row.secrets} & {KEY, TOKEN}} == needs
