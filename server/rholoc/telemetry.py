"""Traces, by OpenTelemetry: where the environment asks for them. Elsewhere nothing of it is imported.

The standard variables say what is exported, and where to: ``OTEL_EXPORTER_OTLP_ENDPOINT`` (or its ``…_TRACES_…``)
turns traces on, ``OTEL_SDK_DISABLED=true`` or ``OTEL_TRACES_EXPORTER=none`` off; the SDK itself reads the others.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from opentelemetry.context import Context
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.trace import Span, Tracer

_ENDPOINTS = ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_EXPORTER_OTLP_ENDPOINT")
_NAME_VARIABLE = "OTEL_SERVICE_NAME"
_TRACEPARENT = "traceparent"
_NS_PER_S = 1e9
_log = logging.getLogger("rholoc.telemetry")

Value = str | int | float | bool


class _Tracing:
    """Makes spans, and exports them."""

    def __init__(self, provider: TracerProvider) -> None:
        self.provider = provider
        self.tracer: Tracer = provider.get_tracer("rholoc")


_tracing: _Tracing | None = None


def wanted(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether the environment names an OTLP endpoint, and does not switch tracing off."""
    off = (
        environment.get("OTEL_SDK_DISABLED", "").lower() == "true" or environment.get("OTEL_TRACES_EXPORTER") == "none"
    )
    return not off and any(environment.get(name) for name in _ENDPOINTS)


def begin(service: str) -> None:
    """Trace this process from now on, if the environment asks for it; a warning is logged if the library is not
    installed.

    Args:
        service: the name under which its spans are shown, unless the environment has another.
    """
    if not wanted() or _tracing is not None:
        return
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError:
        _log.warning(
            "traces_not_exported", extra={"hint": "The environment asks for traces: pip install 'rholoc[telemetry]'."}
        )
        return
    named = {} if os.environ.get(_NAME_VARIABLE) else {"service.name": service}
    provider = TracerProvider(resource=Resource.create(named))
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    use(provider)


def use(provider: TracerProvider | None) -> None:
    """Make spans by a provider from now on; none at all if it is None."""
    global _tracing
    _tracing = None if provider is None else _Tracing(provider)


def end() -> None:
    """Export what has not been exported yet, and trace no more."""
    if _tracing is not None:
        _tracing.provider.shutdown()
    use(None)


class Marks:
    """Attributes of a span; ignored if nothing is traced."""

    def __init__(self, present: Span | None = None) -> None:
        self._span = present

    def rename(self, name: str) -> None:
        """Rename the span."""
        if self._span is not None:
            self._span.update_name(name)

    def set(self, attributes: Mapping[str, Value]) -> None:
        """Add attributes to the span."""
        if self._span is not None:
            self._span.set_attributes(dict(attributes))

    def fail(self, why: str) -> None:
        """Mark the span as failed, for the reason ``why``."""
        if self._span is not None:
            from opentelemetry.trace import StatusCode

            self._span.set_status(StatusCode.ERROR, why)


_NOTHING = Marks()


@contextmanager
def request_span(name: str, headers: Mapping[str, str]) -> Iterator[Marks]:
    """Context of a request's span, in the trace of its header ``traceparent`` or a new one; empty without tracing."""
    if _tracing is None:
        yield _NOTHING
        return
    from opentelemetry.trace import SpanKind

    with _tracing.tracer.start_as_current_span(name, _context(headers), SpanKind.SERVER) as present:
        yield Marks(present)


@contextmanager
def job_span(name: str, attributes: Mapping[str, Value], asked_in: str | None) -> Iterator[Marks]:
    """Trace the block, work that was asked for earlier: a trace of its own, linked to the request's.

    Args:
        name: what is done.
        attributes: of the span.
        asked_in: the request's span, as :func:`traceparent` gave it; None if it was not traced.
    """
    if _tracing is None:
        yield _NOTHING
        return
    from opentelemetry.context import Context
    from opentelemetry.trace import Link, SpanKind, get_current_span

    cause = get_current_span(_context({_TRACEPARENT: asked_in or ""})).get_span_context()
    links = [Link(cause)] if cause.is_valid else []
    with _tracing.tracer.start_as_current_span(name, Context(), SpanKind.CONSUMER, attributes, links) as present:
        yield Marks(present)


@contextmanager
def span(name: str, attributes: Mapping[str, Value] | None = None, *, of_others: bool = False) -> Iterator[Marks]:
    """Trace the block as a part of what is traced at present; does nothing if nothing is.

    Args:
        name: what is done within.
        attributes: of the span.
        of_others: whether another service does it.
    """
    if _tracing is None or traceparent() is None:
        yield _NOTHING
        return
    from opentelemetry.trace import SpanKind

    kind = SpanKind.CLIENT if of_others else SpanKind.INTERNAL
    with _tracing.tracer.start_as_current_span(name, None, kind, attributes) as present:
        yield Marks(present)


def note(name: str, took_s: float, attributes: Mapping[str, Value] | None = None, *, of_others: bool = False) -> None:
    """Add a span of what was done in the last ``took_s`` seconds to what is traced at present; if nothing is, none."""
    if _tracing is None or traceparent() is None:
        return
    from opentelemetry.trace import SpanKind

    kind = SpanKind.CLIENT if of_others else SpanKind.INTERNAL
    now = time.time_ns()
    _tracing.tracer.start_span(name, kind=kind, attributes=attributes, start_time=now - int(took_s * _NS_PER_S)).end(
        now
    )


def traceparent() -> str | None:
    """The present span as a W3C ``traceparent``; None if nothing is traced."""
    if _tracing is None:
        return None
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    carrier: dict[str, str] = {}
    TraceContextTextMapPropagator().inject(carrier)
    return carrier.get(_TRACEPARENT)


def is_on() -> bool:
    """Whether this process is traced."""
    return _tracing is not None


def _context(headers: Mapping[str, str]) -> Context:
    """The context that the W3C headers name; without any, one without a parent."""
    from opentelemetry.context import Context
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    return TraceContextTextMapPropagator().extract(headers, Context())
