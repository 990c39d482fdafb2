"""The service's metrics for Prometheus, and the traces of requests (W3C ``traceparent``)."""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rholoc import telemetry
from rholoc.service.access.guard import API_PATHS
from rholoc.service.access.scopes import found_route, request_key

_log = logging.getLogger("rholoc.service")
METRICS_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_KEPT_S = 0.5
_MAX_MAPS = 200  # with their own counters, one for each outcome
_OTHER_MAPS = "other maps"  # not a valid map name
_SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 60.0)
_FAILED = 500  # statuses from here on


class Metrics:
    """The counters of one service, and gauges that are evaluated when they are read."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry()
        self._making = threading.Lock()
        self._text, self._made_s = b"", -math.inf
        self._requests = Histogram(
            "rholoc_request_seconds",
            "How long requests took, until the last byte of their answers",
            ("method", "route", "status"),
            buckets=_SECONDS,
            registry=self._registry,
        )
        self._localizations = Counter(
            "rholoc_localizations", "Frames that were localized, or why not", ("outcome",), registry=self._registry
        )
        self._of_maps = Counter(
            "rholoc_map_localizations",
            "The same by the map that answered; beyond 200 maps, those that answered later are together 'other maps'",
            ("map", "outcome"),
            registry=self._registry,
        )
        self._stages = Histogram(
            "rholoc_stage_seconds",
            "How long the stages of answering frames took",
            ("stage",),
            buckets=_SECONDS,
            registry=self._registry,
        )
        self._maps: set[str] = set()

    def request(self, method: str, route: str, status: int, duration_s: float) -> None:
        """Count a request that was answered, and its time [s], by method, route and status."""
        self._requests.labels(method, route, str(status)).observe(duration_s)

    def localization(self, map_name: str, reason: str | None, timings_ms: Mapping[str, float]) -> None:
        """Count a frame by reason (None for a pose), also by map for the first 200 maps, and the time of each stage."""
        self._localizations.labels(reason or "localized").inc()
        if len(self._maps) < _MAX_MAPS:
            self._maps.add(map_name)
        self._of_maps.labels(map_name if map_name in self._maps else _OTHER_MAPS, reason or "localized").inc()
        for stage, duration_ms in timings_ms.items():
            self._stages.labels(stage).observe(max(0.0, duration_ms / 1000))

    def gauge(self, name: str, text: str, label: str, read: Callable[[], Mapping[str, float]]) -> None:
        """Add a gauge ``name``, described by ``text``, whose values by ``label`` are read whenever the metrics are."""
        self._registry.register(_Gauge(name, text, label, read))

    def text(self) -> bytes:
        """All metrics in Prometheus's format, cached for half a second."""
        with self._making:
            if time.monotonic() - self._made_s > _KEPT_S:
                self._text, self._made_s = generate_latest(self._registry), time.monotonic()
            return self._text


class _Gauge(Collector):
    def __init__(self, name: str, text: str, label: str, read: Callable[[], Mapping[str, float]]) -> None:
        self._name, self._text, self._label, self._read = name, text, label, read

    def describe(self) -> Iterator[GaugeMetricFamily]:
        """Yield the gauge without values."""
        yield GaugeMetricFamily(self._name, self._text, labels=[self._label])

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield the gauge with its present values; with none, and a warning in the log, if they cannot be read."""
        family = GaugeMetricFamily(self._name, self._text, labels=[self._label])
        try:
            values = self._read()
        except Exception as error:  # of any driver; must not prevent other metrics
            _log.warning("gauge_unread", extra={"gauge": self._name, "error": repr(error)[:200]})
            values = {}
        for value, number in values.items():
            family.add_metric([value], number)
        yield family


class _NotingStatus:
    """An ASGI ``send`` that notes the answer's status; 0 before there is one."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self.status = 0

    async def __call__(self, message: Message) -> None:
        """Send one message."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
        await self._send(message)


class Metered:
    """ASGI middleware that counts every request under its route's path, so that names do not become labels."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        method, begun, noting = scope["method"], time.perf_counter(), _NotingStatus(send)
        try:
            await self._app(scope, receive, noting)
        finally:
            route, duration_s = found_route(scope), time.perf_counter() - begun
            if route is None:  # invented paths and methods must not become labels
                self._metrics.request("other", "other", noting.status, duration_s)
            else:
                self._metrics.request(method, route.path, noting.status, duration_s)


class Traced:
    """ASGI middleware that traces requests to paths of the API, so neither the page nor probes, while telemetry is on.

    Args:
        app: the next application.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if not telemetry.is_on() or scope["type"] != "http" or not scope["path"].startswith(API_PATHS):
            await self._app(scope, receive, send)
            return
        method = scope["method"]
        with telemetry.request_span(method, Headers(scope=scope)) as marks:
            noting = _NotingStatus(send)
            try:
                await self._app(scope, receive, noting)
            finally:
                route, key = found_route(scope), request_key(scope)
                if route is not None:
                    marks.rename(f"{method} {route.path}")
                    marks.set({"http.route": route.path})
                if key is not None:
                    marks.set({"rholoc.key": key.name})
                marks.set(
                    {
                        "http.request.method": method,
                        "http.response.status_code": noting.status,
                        "url.path": scope["path"],
                        "rholoc.request_id": scope.get("state", {}).get("request_id", ""),
                    }
                )
                if noting.status >= _FAILED:
                    marks.fail(f"answered with {noting.status}")
