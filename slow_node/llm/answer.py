"""What a chat server answered: the model's text, apart from its thoughts, wherever this server's dialect puts them."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from schemas.wire.text import plain
from slow_node.llm.errors import ModelError, http_error

MAX_ANSWER_CHARS = 20_000
"""Of the text, and of the thoughts; of what is longer, the end, where the answer is."""
SENTENCE_CHARS = 200
"""Of a server's own words in an error."""
_MARKS = r"think(?:ing)?|thoughts?|reason(?:ing)?|reflection"
_OPENS = re.compile(
    rf"<(?:{_MARKS})>|\[THINK\]|◁think▷|<\|channel\|?>\s*(?:analysis|commentary|thought)", re.IGNORECASE
)
_CLOSES = re.compile(
    rf"</(?:{_MARKS})>|\[/THINK\]|◁/think▷|<channel\|>|<\|channel\|>\s*final.*?<\|message\|>", re.IGNORECASE
)
_BLOCK = re.compile(
    rf"<({_MARKS})>.*?</\1>|\[THINK\].*?\[/THINK\]|◁think▷.*?◁/think▷|<\|channel>\s*thought.*?<channel\|>",
    re.IGNORECASE | re.DOTALL,
)
_ENDS = re.compile(r"<\|(?:return|end|im_end|eot_id)\|>\s*\Z")
_ANOTHER = re.compile(r'\{\s*"')
_SECRET = re.compile(r"\b(?:sk|pk|gsk|xai|nvapi|hf|key)[-_][\w*.-]{6,}|(?<=Bearer )\S+", re.IGNORECASE)
_TITLE = re.compile(r"<title[^>]*>(.*?)</title>", re.IGNORECASE | re.DOTALL)


@dataclass(frozen=True)
class Answer:
    """A chat server's answer."""

    text: str
    """The model's, without its thoughts."""
    thinking: str = ""
    finish: str = ""
    """Why it ended, in the server's word: "stop", "length", ..."""
    prompt_tokens: int = 0
    answer_tokens: int = 0
    """The thoughts' included."""
    cost_usd: float | None = None
    """As the server tells; None: it does not."""
    model: str = ""
    """What the server says has answered."""
    id: str = ""
    probability: float | None = None
    """Of the text, as the model has it: the product of its tokens'; None: the server does not tell."""


class ModelAnswerError(ModelError):
    """The server is well (HTTP 2xx), but what it answered is of no use: no chat, or a refusal of the model's."""

    def __init__(self, why: str, *, again: bool = False, answer: Answer | None = None) -> None:
        super().__init__(why)
        self.again = again
        self.answer = answer
        """What came all the same: its tokens are paid for, its thoughts are worth a look."""


def read_answer(content: bytes, secret: str = "") -> Answer:
    """The answer in an HTTP body. secret: never repeated in an error.

    Raises `ModelError` for what is none, for a model that declines, and for one whose tokens were used up by its
    thoughts: the latter two with the answer, which has cost something.
    """
    try:
        body = json.loads(content)
    except (ValueError, RecursionError):
        raise ModelAnswerError("the model's server sent no JSON, or a part of it", again=True) from None
    if isinstance(body, dict) and body.get("error"):  # some proxies answer HTTP 200 and tell of the failure inside
        sentence, code = told(content, secret)
        raise http_error(_status(body["error"]), sentence, code)
    try:
        choice = body["choices"][0]
        message = choice.get("message") or choice["delta"]
        given, thought = _parts(message.get("content"))
    except (LookupError, TypeError, AttributeError):
        raise ModelAnswerError("the model's server did not answer in the OpenAI chat format") from None
    usage = body.get("usage") if isinstance(body.get("usage"), dict) else {}
    thought_in_text, text = split_thoughts(given)
    aside = _text(message.get("reasoning_content")) or _text(message.get("reasoning"))
    finish = _text(choice.get("finish_reason"))
    text = text or _called(message) or (_said_aside(aside) if finish != "length" else "")
    answer = Answer(
        text=text[:MAX_ANSWER_CHARS],
        thinking="\n".join(filter(None, (aside, thought, thought_in_text)))[:MAX_ANSWER_CHARS],
        finish=plain(finish, 40),
        prompt_tokens=_count(usage.get("prompt_tokens")),
        answer_tokens=_count(usage.get("completion_tokens")),
        cost_usd=_cost(usage.get("cost")),
        model=plain(_text(body.get("model")), 120),
        id=plain(_text(body.get("id")), 120),
        probability=_probability(choice.get("logprobs")),
    )
    _check(answer, message, secret)
    return answer


def _check(answer: Answer, message: Mapping[str, Any], secret: str) -> None:
    refusal = _text(message.get("refusal"))
    if refusal or (answer.finish == "content_filter" and not answer.text):
        said = _safe(refusal, secret)
        raise ModelAnswerError(f"the model declined to answer{f': {said}' if said else ''}", answer=answer)
    if not answer.text and answer.finish == "length":
        raise ModelAnswerError(
            "the model used up its tokens before it answered: give it more with --max-tokens", answer=answer
        )
    if not answer.text and answer.thinking:
        raise ModelAnswerError("the model thought and answered nothing", again=True, answer=answer)


def split_thoughts(content: str) -> tuple[str, str]:
    """(thoughts, answer) of a model that writes both into one text. Thoughts without an end leave no answer."""
    # The patterns take the square of the length where marks open and never close.
    stripped = content[-MAX_ANSWER_CHARS:].strip()
    if _is_object(stripped):  # whatever its strings say
        return "", stripped
    thoughts: list[str] = []

    def moved(block: re.Match[str]) -> str:
        thoughts.append(block.group())
        return ""

    rest = _BLOCK.sub(moved, stripped)
    for close in reversed(list(_CLOSES.finditer(rest))):  # begun by the server's own template, or one within another
        thoughts.append(rest[: close.start()])
        rest = rest[close.end() :]
        break
    begun = _OPENS.search(rest)
    if begun is not None:
        thoughts.append(rest[begun.start() :])
        rest = rest[: begun.start()]
    bare = (_CLOSES.sub("", _OPENS.sub("", thought)).strip() for thought in thoughts)
    return "\n".join(bare), _ENDS.sub("", rest).strip()


def json_object(text: str) -> dict[str, Any]:
    """The one JSON object in a text, which may wrap it in prose.

    Raises ValueError, in words that a model can act on, for none, for a broken one, and for several that differ: nobody
    can tell which of them is meant.
    """
    # Not strict: models write line breaks into strings.
    decoder, found, at = json.JSONDecoder(strict=False), [], text.find("{")
    end, tries = 0, 0
    while at >= 0 and tries < 50:
        tries += 1
        try:
            value, end = decoder.raw_decode(text, at)
        except ValueError:
            at = text.find("{", at + 1)
            continue
        except RecursionError:
            break
        if value and value not in found:
            found.append(value)
        at = text.find("{", end)
    if not found:
        raise ValueError("its JSON object is broken or cut off" if "{" in text else "it contains no JSON object")
    if len(found) > 1:
        raise ValueError("it contains several JSON objects that differ")
    if _ANOTHER.search(text, end):
        raise ValueError("its last JSON object is broken or cut off")
    only: dict[str, Any] = found[0]
    return only


def told(content: bytes, secret: str = "") -> tuple[str, str]:
    """(sentence, code) of an error as a server tells it: plain, on one line, with no secret in it; "" for nothing."""
    try:
        body = json.loads(content)
    except (ValueError, RecursionError):
        text = content[:10_000].decode(errors="replace")
        page = _TITLE.search(text)
        return _safe(page.group(1) if page else "" if text.lstrip().startswith("<") else text, secret), ""
    error = body.get("error", body) if isinstance(body, dict) else body
    code = _text(error.get("code")) if isinstance(error, dict) else ""
    return _safe(_sentence(error), secret), code


def _sentence(error: Any) -> str:
    """OpenAI, OpenRouter: {"message"}; Ollama: a string; FastAPI: {"detail"}, a string or a list of {"msg"}."""
    if isinstance(error, str):
        return error
    if isinstance(error, list):
        return "; ".join(filter(None, map(_sentence, error[:3])))
    if not isinstance(error, dict):
        return ""
    upstream = error.get("metadata")
    raw = _text(upstream.get("raw")) if isinstance(upstream, dict) else ""
    said = next((s for key in ("message", "msg", "detail", "error") if (s := _sentence(error.get(key)))), "")
    return f"{said}: {raw}" if raw and said else said or raw


def _safe(sentence: str, secret: str) -> str:
    if secret:
        sentence = sentence.replace(secret, "…")
    return plain(_SECRET.sub("…", sentence), SENTENCE_CHARS)


def _parts(content: Any) -> tuple[str, str]:
    """(text, thoughts) of a message's content: a string, nothing, or a list of parts."""
    if content is None or isinstance(content, str):
        return content or "", ""
    if not isinstance(content, list):
        raise TypeError
    text, thoughts = [], []
    for part in content:
        kind = _text(part.get("type"))
        if kind in ("thinking", "reasoning"):
            thoughts.append(_parts(part.get("thinking") or part.get("text") or part.get("reasoning"))[0])
        else:
            text.append(_text(part.get("text")))
    return "".join(text), "".join(thoughts)


def _called(message: Mapping[str, Any]) -> str:
    """The answer as the arguments of a tool call, which some models make although no tool was offered."""
    calls = message.get("tool_calls")
    first = calls[0] if isinstance(calls, list) and calls else {"function": message.get("function_call")}
    function = first.get("function") if isinstance(first, dict) else None
    arguments = function.get("arguments") if isinstance(function, dict) else None
    return json.dumps(arguments) if isinstance(arguments, dict) else _text(arguments)


def _said_aside(thoughts: str) -> str:
    """The answer of a server that takes a whole answer for thoughts: those must end with an object."""
    _, text = split_thoughts(thoughts)
    start = text.find("{")
    return text[start:] if start >= 0 and _is_object(text[start:]) else ""


def _is_object(text: str) -> bool:
    try:
        return text.startswith("{") and isinstance(json.loads(text, strict=False), dict)
    except (ValueError, RecursionError):
        return False


def _status(error: Any) -> int:
    code = error.get("code") if isinstance(error, dict) else None
    return code if isinstance(code, int) and 400 <= code < 600 else 502


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def _count(value: object) -> int:
    return min(value, 10**9) if isinstance(value, int) and value > 0 else 0


def _probability(logprobs: Any) -> float | None:
    tokens = logprobs.get("content") if isinstance(logprobs, dict) else None
    if not isinstance(tokens, list) or not tokens:
        return None
    each = [token.get("logprob") if isinstance(token, dict) else None for token in tokens]
    told = [float(one) for one in each if isinstance(one, (int, float)) and math.isfinite(one)]
    return math.exp(min(sum(told), 0.0)) if len(told) == len(each) else None


def _cost(value: object) -> float | None:
    return float(value) if isinstance(value, (int, float)) and 0 <= value < 1e6 else None
