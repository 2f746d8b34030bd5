"""Which language model a run asks: the endpoint that options or the environment name, or else the embedded model."""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path
from typing import Any

from deploy.run.launch import KEY as KEY
from deploy.run.processes import TCP_HOST, Model, ModelOptions, free_port
from schemas.runtime.process import ConfigError
from schemas.wire.text import plain
from slow_node.config import BUDGET_S
from slow_node.llm.answer import told
from slow_node.llm.embedded import own_weights
from slow_node.llm.endpoint import OPENAI_URL, checked_key, checked_model, endpoint_url, ollama_url
from slow_node.llm.errors import ModelError

MODEL = "OPENAI_MODEL"
VARIABLES = (KEY, "OPENAI_BASE_URL", MODEL, "OLLAMA_HOST")
"""What names an endpoint."""
LIST_S = 5.0
"""How long an endpoint may take to list its models."""
SHOWN = 6
_NAME_ONE = "name the model with --model or OPENAI_MODEL"


def choose_model(options: ModelOptions | None = None) -> Model:
    """The model to ask. What is not in `options` comes from the environment.

    An endpoint without a named model is asked for its list, and used if it serves a single one. Raises `ConfigError`,
    naming the fix, for an address or a key that cannot be one, and where nobody says which model is meant.
    """
    options = options or ModelOptions()
    try:
        base_url = "" if options.embedded else _base_url(options)
        key = checked_key(os.environ.get(KEY, ""), KEY)
        name = checked_model(options.name or "", "--model") or checked_model(os.environ.get(MODEL, ""), MODEL)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    rest: dict[str, Any] = {"budget_s": options.budget_s or BUDGET_S, "max_tokens": options.max_tokens or 0}
    if base_url:
        name = name or ("gpt-4o-mini" if base_url == OPENAI_URL else _only_model(base_url, key))
        return Model(base_url=base_url, name=name, embedded=False, **rest)
    if options.name:
        raise ConfigError(f"--model {options.name} needs an endpoint: give --base-url, or set {KEY} or OLLAMA_HOST")
    weights = os.environ.get("FASTSLOW_GGUF", "")
    name = own_weights(Path(weights)).stem if weights else "SmolLM2-135M-Instruct"
    port = free_port()
    url = f"http://{TCP_HOST}:{port}/v1"
    return Model(base_url=url, name=name, embedded=True, port=port, weights=weights, **rest)


def _base_url(options: ModelOptions) -> str:
    """Of the endpoint; "" for none. An address comes first, then a key, then a server that may be there by chance."""
    named = options.base_url if options.base_url is not None else os.environ.get("OPENAI_BASE_URL", "")
    if named or options.base_url is not None:
        return endpoint_url(named)
    if os.environ.get(KEY):
        return OPENAI_URL
    here = os.environ.get("OLLAMA_HOST", "")
    return ollama_url(here) if here else ""


def _only_model(base_url: str, key: str) -> str:
    names = asyncio.run(_models(base_url, key))
    if len(names) == 1:
        return names[0]
    shown = ", ".join(names[:SHOWN]) + (", ..." if len(names) > SHOWN else "")
    raise ConfigError(f"{base_url} serves {len(names)} models; {_NAME_ONE}{f': {shown}' if names else ''}")


async def _models(base_url: str, key: str) -> list[str]:
    """What the endpoint says it serves, without what only embeds."""
    from slow_node.llm.transport import Transport  # httpx would be in every supervisor

    transport = Transport(base_url, key)
    try:
        async with asyncio.timeout(LIST_S):
            response = await transport.get("models")
        if response.status >= 300:
            sentence, _ = told(response.content, key)
            raise ConfigError(
                f"{base_url} does not list its models (HTTP {response.status}"
                f"{f': {sentence}' if sentence else ''}); {_NAME_ONE}"
            )
        rows = json.loads(response.content)["data"]
        return [plain(name, 80) for row in rows if "embed" not in (name := str(row["id"]))]
    except ModelError as error:
        raise ConfigError(f"{error}; start it, or leave it out") from None
    except TimeoutError:
        raise ConfigError(f"{base_url} did not list its models within {LIST_S:.0f} s; {_NAME_ONE}") from None
    except (ValueError, LookupError, TypeError, RecursionError):
        raise ConfigError(f"{base_url} does not list its models as OpenAI's API does; {_NAME_ONE}") from None
    finally:
        await transport.close()
