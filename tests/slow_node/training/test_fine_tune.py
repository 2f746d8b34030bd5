"""The adapter of the embedded model: what it is trained on is what the engine will ask it."""

from __future__ import annotations

import json
import urllib.request
from collections.abc import Iterator
from typing import Any, cast

import gguf
import pytest
import torch

from deploy.run.launch import model_token
from deploy.run.model_server import embedded_server
from deploy.run.processes import free_port
from slow_node.llm.embedded import weights_path
from slow_node.planning.prompt import Asked, program_prompt
from slow_node.training.fine_tune import END, Llama, batches, loss_of, rate_at, rendered, tokenizer_of

TEXTS = ("I'm late, step on it!", "non, à 90 km/h", 'say "<|im_end|>" and go left', "快一点 2025")
FASTER = '{"outcome":"directive","steps":[{"act":"faster"}]}'


def chat(text: str) -> list[dict[str, str]]:
    return program_prompt(Asked(text, "lane 2/4, 25/33 mps, free left", turns=("lane left",)))


@pytest.fixture(scope="module")
def reader() -> Any:
    return gguf.GGUFReader(weights_path())


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    port = free_port()
    process = embedded_server(port, 1, adapter=False)
    assert process is not None
    yield f"http://127.0.0.1:{port}"
    process.end()


def post(url: str, body: dict[str, Any]) -> Any:
    headers = {"content-type": "application/json", "authorization": f"Bearer {model_token()}"}
    request = urllib.request.Request(url, json.dumps(body).encode(), headers)
    with urllib.request.urlopen(request, timeout=30) as answer:
        return json.load(answer)


@pytest.mark.parametrize("text", TEXTS)
def test_the_chat_that_is_learnt_from_is_the_one_that_the_engine_writes(text: str, server: str) -> None:
    assert post(f"{server}/apply-template", {"messages": chat(text)})["prompt"] == rendered(chat(text))


@pytest.mark.parametrize("text", TEXTS)
def test_its_tokens_are_the_engines(text: str, server: str, reader: Any) -> None:
    whole = rendered(chat(text)) + FASTER + END
    theirs = post(f"{server}/tokenize", {"content": whole, "add_special": True, "parse_special": True})["tokens"]
    assert tokenizer_of(reader).encode(whole, add_special_tokens=False).ids == theirs


def test_before_it_has_learnt_anything_it_is_the_model_of_the_package(reader: Any) -> None:
    tokenizer = tokenizer_of(reader)
    ids = torch.tensor([tokenizer.encode("The capital of France is").ids])
    last = torch.tensor([[False] * (ids.shape[1] - 1) + [True]])
    with torch.no_grad():
        assert tokenizer.decode(Llama(reader)(ids, last).argmax(-1).tolist()).strip() == "Paris"


def test_only_the_tokens_of_the_answer_count_and_each_is_told_from_those_before_it(reader: Any) -> None:
    pairs = [(chat(text), FASTER) for text in ("go faster", "please go a good deal faster than now")]
    [(ids, answer)] = batches(pairs, tokenizer_of(reader), 0)
    said = [tokenizer_of(reader).decode(row[mask].tolist()) for row, mask in zip(ids, answer, strict=True)]
    assert said == [FASTER] * 2

    def knows_what_follows(seen: Any, wanted: Any) -> Any:
        assert torch.equal(seen, ids[:, :-1])
        return 1e4 * torch.nn.functional.one_hot(ids[:, 1:][wanted], int(ids.max()) + 1).float()

    assert float(loss_of(cast(Llama, knows_what_follows), ids, answer)) == pytest.approx(0.0)


def test_a_training_that_was_stopped_goes_on_with_the_batches_it_has_not_seen(reader: Any) -> None:
    pairs = [(chat(f"go faster {n}"), FASTER) for n in range(400)]
    tokenizer = tokenizer_of(reader)
    whole = [ids.tolist() for ids, _ in batches(pairs, tokenizer, 0)]
    assert [ids.tolist() for ids, _ in batches(pairs, tokenizer, 0, skip=18)] == whole[18:]


def test_the_rate_rises_and_falls_and_never_is_nothing() -> None:
    rates = [rate_at(step, 100) for step in range(1, 101)]
    assert max(rates) == 1.0
    assert 0.0 < rates[-1] < rates[0] < 0.1
