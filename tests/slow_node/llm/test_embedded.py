"""Another embedded model than the shipped one."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.run.model_choice import choose_model
from deploy.run.processes import RunOptions, process_table
from schemas.runtime.process import ConfigError
from slow_node.llm.embedded import EmbeddedConfig, own_weights


def test_a_gguf_file_of_ones_own_takes_the_place_of_the_shipped_model_without_its_adapter(tmp_path, monkeypatch):
    file = tmp_path / "other-model.gguf"
    file.write_bytes(b"GGUF" + bytes(60))
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    monkeypatch.setenv("FASTSLOW_GGUF", str(file))
    model = choose_model()
    rows = {row.name: row for row in process_table(RunOptions(), model, tmp_path)}
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
