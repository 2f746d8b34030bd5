"""Thoughts as OpenTelemetry spans, by the GenAI conventions, sent where `OTEL_EXPORTER_OTLP_ENDPOINT` says.

A command is one `invoke_agent` span; below it, each answer that the language model was asked for is one `chat` span,
with every retry an event. Words, of passenger and model, are left out unless
`OTEL_INSTRUMENTATION_GENAI_CAPTURE_MESSAGE_CONTENT` is `true`.
"""

from __future__ import annotations

import json
import os
import re
import threading
import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from schemas.runtime.process import log
from schemas.wire.thought import Thought
from slow_node.llm.endpoint import is_azure
from slow_node.llm.model import Call, ChatModel
from slow_node.thought import Trace

ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")
CONTENT = "OTEL_INSTRUMENTATION_GENAI_CAPTURE_MESSAGE_CONTENT"
FLUSH_S = 1.0
AGENT = "fastslow"
_STATUS = re.compile(r"HTTP (\d{3})")


class Telemetry:
    """Makes spans of thoughts. `provider`: OpenTelemetry's; None: nothing is made."""

    def __init__(self, provider: Any, model: ChatModel, *, content: bool = False) -> None:
        """content: with the words that were said, asked and answered."""
        self._provider, self._model, self._content = provider, model, content
        self._tracer = provider.get_tracer(AGENT) if provider is not None else None

    def thought(self, trace: Trace, thought: Thought) -> None:
        """The spans of one command, which has just been understood, or given up."""
        if self._tracer is None:
            return
        from opentelemetry.trace import SpanKind, set_span_in_context

        whole = self._tracer.start_span(
            f"invoke_agent {AGENT}",
            kind=SpanKind.INTERNAL,
            start_time=_ns(trace.began_s),
            attributes=self._agent(thought),
        )
        below = set_span_in_context(whole)
        for calls in _asked(trace.calls):
            self._chat(calls, trace, below)
        whole.end(time.time_ns())

    def close(self) -> None:
        """Send what waits, for a moment at most."""
        if self._provider is None:
            return
        # OpenTelemetry's own limit does not hold where nobody listens: it waits between its tries.
        flush = threading.Thread(target=self._provider.force_flush, daemon=True)
        flush.start()
        flush.join(FLUSH_S)

    def _agent(self, thought: Thought) -> dict[str, Any]:
        attributes: dict[str, Any] = {
            "gen_ai.operation.name": "invoke_agent",
            "gen_ai.agent.name": AGENT,
            "gen_ai.provider.name": self._provider_name,
            "fastslow.command_id": str(thought.command_id),
            "fastslow.outcome": thought.outcome,
            "fastslow.decided_by": thought.source,
            "fastslow.slots": thought.slots,
            **{f"fastslow.{name}_ms": ms for name, ms in thought.spans_ms.items()},
        }
        if thought.cost_usd is not None:
            attributes["fastslow.cost_usd"] = thought.cost_usd
        if self._content:
            attributes["gen_ai.input.messages"] = _messages([{"role": "user", "content": thought.command}])
        return attributes

    def _chat(self, calls: list[Call], trace: Trace, below: Any) -> None:
        """One answer that was asked for: all exchanges until it came."""
        from opentelemetry.trace import SpanKind, Status, StatusCode

        assert self._tracer is not None
        last, model = calls[-1], self._model
        server = urlsplit(model.base_url)
        span = self._tracer.start_span(
            f"chat {model.name}",
            context=below,
            kind=SpanKind.CLIENT,
            start_time=_ns(calls[0].began_s),
            attributes={
                "gen_ai.operation.name": "chat",
                "gen_ai.provider.name": self._provider_name,
                "gen_ai.request.model": model.name,
                "gen_ai.request.max_tokens": model.max_tokens,
                "gen_ai.output.type": "text" if last.format == "text" else "json",
                "server.address": server.hostname or "",
                "server.port": server.port or (443 if server.scheme == "https" else 80),
            },
        )
        for call in calls[:-1]:
            span.add_event("retry", {"error.message": call.error}, timestamp=_ns(call.began_s + call.ms / 1000.0))
        if last.error or last.answer is None:
            status = _STATUS.search(last.error)
            span.set_attribute("error.type", status.group(1) if status else "_OTHER")
            span.set_status(Status(StatusCode.ERROR, last.error))
        else:
            answer = last.answer
            span.set_attributes(
                {
                    "gen_ai.response.id": answer.id,
                    "gen_ai.response.model": answer.model or model.name,
                    "gen_ai.response.finish_reasons": [answer.finish],
                    "gen_ai.usage.input_tokens": answer.prompt_tokens,
                    "gen_ai.usage.output_tokens": answer.answer_tokens,
                }
            )
            if self._content:
                said = [{"role": "assistant", "content": answer.text, "finish_reason": answer.finish}]
                span.set_attribute("gen_ai.output.messages", _messages(said))
        if self._content:
            span.set_attribute("gen_ai.input.messages", _messages(trace.prompt))
        span.end(_ns(last.began_s + last.ms / 1000.0))

    @property
    def _provider_name(self) -> str:
        """Whose API it is that the server speaks."""
        return "azure.ai.openai" if is_azure(self._model.base_url) else "openai"


def telemetry_of(model: ChatModel) -> Telemetry:
    """As the environment wants it: spans go nowhere unless it names where."""
    return Telemetry(_exporting(), model, content=os.environ.get(CONTENT, "").lower() == "true")


def _exporting() -> Any:
    if not any(os.environ.get(name) for name in ENDPOINTS):
        return None
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError as error:
        log("slow", "telemetry", f"no spans are sent: {error.name} is missing: run `pip install 'fastslow[otel]'`")
        return None
    name = {} if os.environ.get("OTEL_SERVICE_NAME") else {"service.name": AGENT}
    try:
        provider = TracerProvider(resource=Resource.create(name), shutdown_on_exit=False)
        provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    except Exception as error:  # whatever its settings hold: nobody drives worse without spans
        log("slow", "telemetry", f"no spans are sent: {type(error).__name__}: {error}")
        return None
    return provider


def _asked(calls: list[Call]) -> Iterator[list[Call]]:
    """The exchanges of each answer that was asked for: up to the one that has it, or has failed last."""
    group: list[Call] = []
    for call in calls:
        group.append(call)
        if not call.error:
            yield group
            group = []
    if group:
        yield group


def _messages(turns: list[dict[str, str]]) -> str:
    """The conventions' form of a chat, as JSON."""
    return json.dumps(
        [
            {
                **{key: value for key, value in turn.items() if key != "content"},
                "parts": [{"type": "text", "content": turn["content"]}],
            }
            for turn in turns
        ]
    )


def _ns(unix_s: float) -> int:
    return round(unix_s * 1e9)
