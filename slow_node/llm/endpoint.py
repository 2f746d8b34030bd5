"""Where a language model is asked: what users write as its address, and whether their words leave the machine."""

from __future__ import annotations

import ipaddress
from urllib.parse import parse_qsl, urlsplit

from schemas.wire.text import plain

OPENAI_URL = "https://api.openai.com/v1"
OLLAMA_PORT = 11434
PATHS = {"openrouter.ai": "/api/v1"}
"""Of hosts whose address without a path means another one than /v1."""
AZURE = (".openai.azure.com", ".services.ai.azure.com", ".cognitiveservices.azure.com")
_ROUTES = ("/chat/completions", "/completions", "/responses", "/models")
"""What people copy along from an example."""
URL_CHARS, MODEL_CHARS, KEY_CHARS = 1000, 200, 4000
"""Of an address, a model's name and a key at most: the longest in use are far shorter."""
_QUERY = ("api-version",)
"""All that a query may hold: anything else might be a secret, and an address is shown and logged."""


def endpoint_url(text: str) -> str:
    """A base URL as a user wrote it, completed: scheme and version added, a copied route taken off.

    Raises ValueError, which names the fix, for what is none, and for one with a secret in it.
    """
    text = text.strip()
    if len(text) > URL_CHARS or not text.isprintable():
        raise ValueError("the base URL must look like http://127.0.0.1:8000/v1")
    if "://" not in text:
        text = f"{'http' if _near(_host(f'//{text}')) else 'https'}://{text}"
    host = _host(text)
    try:
        parts = urlsplit(text)
    except ValueError:  # broken brackets
        raise ValueError("the base URL must look like http://127.0.0.1:8000/v1") from None
    if parts.scheme not in ("http", "https") or not host or any(c.isspace() for c in text):
        raise ValueError("the base URL must look like http://127.0.0.1:8000/v1")
    if "@" in parts.netloc:
        raise ValueError("the base URL holds a name or a password: take it out, and put the key into OPENAI_API_KEY")
    try:
        named = parts.port
    except ValueError:
        raise ValueError(f"the base URL's port {parts.netloc.rpartition(':')[2]!r} is no number in 1..65535") from None
    if named == 0:
        raise ValueError("the base URL's port 0 is no number in 1..65535")
    if other := sorted({name for name, _ in parse_qsl(parts.query, keep_blank_values=True)} - set(_QUERY)):
        raise ValueError(
            f"the base URL may have ?api-version=..., not {other[0]!r}: if that is a key, put it into OPENAI_API_KEY"
        )
    path = parts.path.rstrip("/")
    for route in _ROUTES:
        path = path.removesuffix(route)
    path = path or ("/openai/v1" if is_azure(text) else PATHS.get(host, "/v1"))
    return f"{parts.scheme}://{parts.netloc}{path}{f'?{parts.query}' if parts.query else ''}"


def ollama_url(variable: str) -> str:
    """The base URL for a value of OLLAMA_HOST, which may be an address to listen on. Raises ValueError."""
    variable = variable.strip().strip("\"'").rstrip("/")
    if len(variable) > URL_CHARS or not variable.isprintable() or variable in ("http:", "https:"):
        raise ValueError(f"OLLAMA_HOST={plain(variable, 40)}: it must look like 127.0.0.1:11434 or [::1]:11434")
    bare = "://" not in variable
    if bare and _is_ipv6(variable):  # without brackets, as a shell user writes it
        variable = f"[{variable}]"
    try:
        parts = urlsplit(f"http://{variable}" if bare else variable)
    except ValueError:
        raise ValueError(f"OLLAMA_HOST={variable}: it must look like 127.0.0.1:11434 or [::1]:11434") from None
    try:
        port = parts.port or (OLLAMA_PORT if bare else {"https": 443}.get(parts.scheme, 80))
    except ValueError:
        raise ValueError(f"OLLAMA_HOST={variable}: the port is no number in 1..65535") from None
    if "@" in parts.netloc:
        raise ValueError("OLLAMA_HOST holds a name or a password: take it out, and put the key into OPENAI_API_KEY")
    host = parts.hostname or "127.0.0.1"
    if host in ("0.0.0.0", "::"):  # where a server listens, not where it is
        host = "127.0.0.1"
    host = f"[{host}]" if ":" in host else host
    return endpoint_url(f"{parts.scheme}://{host}:{port}{parts.path}")


def checked_key(key: str, variable: str) -> str:
    """The key without surrounding blanks. Raises ValueError, without the key, for one that no header can carry."""
    key = key.strip()
    if len(key) > KEY_CHARS:
        raise ValueError(f"{variable} has {len(key)} characters, more than any key: copy it once more")
    if any(not 32 < ord(c) < 127 for c in key):
        raise ValueError(f"{variable} holds a character that no key has (a blank, an umlaut, ...): copy it once more")
    return key


def checked_model(name: str, variable: str) -> str:
    """A model's name without surrounding blanks. Raises ValueError for what is none."""
    name = name.strip()
    if len(name) > MODEL_CHARS or plain(name) != name:
        raise ValueError(f"{variable} is no model's name: give one of at most {MODEL_CHARS} letters, such as qwen3:8b")
    return name


def is_loopback(base_url: str) -> bool:
    """The URL's host is this machine."""
    host = _host(base_url)
    if host == "localhost" or host.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_azure(base_url: str) -> bool:
    return _host(base_url).endswith(AZURE)


def where(base_url: str, model: str) -> str:
    """For people: which model is asked where, and whether words leave the machine for it."""
    host = urlsplit(base_url).netloc
    if not is_loopback(base_url):
        return f"{model} at {host} (your words and the scene leave this machine)"
    if is_passed_on(model):
        return f"{model} at {host} (your words and the scene leave this machine for Ollama's cloud)"
    return f"{model} at {host} (a server on this machine)"


def is_passed_on(model: str) -> bool:
    """Ollama serves some models from loopback that run elsewhere; their tags say so."""
    return model.rpartition(":")[2].endswith("cloud") and ":" in model


def _host(url: str) -> str:
    try:
        return urlsplit(url).hostname or ""
    except ValueError:
        return ""


def _is_ipv6(text: str) -> bool:
    try:
        return ipaddress.ip_address(text).version == 6
    except ValueError:
        return False


def _near(host: str) -> bool:
    """A host that is unlikely to speak TLS: this machine, the local network."""
    try:
        return ipaddress.ip_address(host).is_private
    except ValueError:
        return "." not in host or host.endswith((".local", ".localhost", ".lan", ".internal"))
