"""While frames are worked on, other requests take a share of the time, and wait for the rest of it."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.service.access.keys import Scope
from rholoc.service.access.scopes import Access, RouteAccess
from rholoc.service.http import pacing
from rholoc.service.http.pacing import FramesFirst, Pace


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@given(st.lists(st.floats(0.0, 0.02), min_size=1, max_size=20), st.integers(1, 5))
def test_together_they_take_no_more_than_their_share(steps_s, parties):
    clock = Clock()
    pace = Pace(0.25, 1000.0, clock)
    took_s = 0.0
    for step_s in steps_s:
        delays_s = [pace.delay_s(step_s) for _ in range(parties)]  # all at the same time
        took_s += parties * step_s
        assert delays_s == sorted(delays_s)
        clock.now_s += delays_s[-1]
    assert took_s <= 0.25 * (clock.now_s - 1000.0) + 1e-6


def test_nobody_waits_for_longer_than_the_longest_time():
    pace = Pace(0.2, 1.0, Clock())
    assert max(pace.delay_s(0.1) for _ in range(100)) == pytest.approx(1.0)


def test_what_was_waited_for_is_forgotten():
    clock = Clock()
    pace = Pace(0.2, 10.0, clock)
    pace.delay_s(1.0)
    clock.now_s += 60.0
    assert pace.delay_s(0.1) == pytest.approx(0.5)


class Counted(Pace):
    """A pace without delays that counts who asks for them."""

    def __init__(self) -> None:
        super().__init__()
        self.asked = 0

    def delay_s(self, took_s: float) -> float:
        self.asked += 1
        return 0.0


def waits(monkeypatch, scope: Scope | None, *, busy: bool) -> int:
    """How often a request of three pieces waits, on a route for that scope."""
    pieces = [{"type": "http.request", "body": b"x", "more_body": more} for more in (True, True, False)]

    async def receive():
        return pieces.pop(0) if pieces else {"type": "http.disconnect"}

    async def send(message):
        assert message["type"].startswith("http.response")

    async def app(scope, receive, send):
        while (await receive()).get("more_body"):
            pass
        assert (await receive())["type"] == "http.disconnect"  # nothing is waited for once the body is whole
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    route = RouteAccess("/", frozenset({"POST"}), Access(scope), frozenset(), False, None)
    monkeypatch.setattr(pacing, "found_route", lambda _: route)
    pace = Counted()
    asyncio.run(FramesFirst(app, lambda _: busy, pace)({"type": "http"}, receive, send))
    return pace.asked


@pytest.mark.parametrize("scope", [Scope.READ, Scope.MAP, Scope.ADMIN])
def test_what_is_not_a_frame_waits_before_each_piece_and_its_answer(monkeypatch, scope):
    assert waits(monkeypatch, scope, busy=True) == 4
    assert waits(monkeypatch, scope, busy=False) == 0


@pytest.mark.parametrize("scope", [Scope.LOCALIZE, None])
def test_frames_and_health_wait_for_nobody(monkeypatch, scope):
    assert waits(monkeypatch, scope, busy=True) == 0
