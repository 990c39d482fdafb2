"""While frames are worked on, other requests take a share of the time, and wait for the rest of it."""

import asyncio

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rholoc.service.access.keys import ApiKey, KeyLimits, KeyStore, Scope
from rholoc.service.access.rates import Rates
from rholoc.service.access.scopes import Access, RouteAccess
from rholoc.service.errors import TooManyRequests
from rholoc.service.http import pacing
from rholoc.service.http.pacing import FramesFirst, Pace
from rholoc.service.settings import KeyPolicy


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


def key(name: str, rate: float | None, burst: int | None = None) -> ApiKey:
    return ApiKey(name, Scope.READ, 0.0, limits=KeyLimits(rate, burst))


def may(rates: Rates, *keys: ApiKey) -> bool:
    try:
        rates.take(keys)
    except TooManyRequests:
        return False
    return True


@given(
    rate=st.floats(0.1, 100),
    burst=st.integers(1, 20),
    pauses=st.lists(st.floats(0, 2), min_size=1, max_size=60),
)
def test_never_more_than_a_burst_and_the_rate(rate: float, burst: int, pauses: list[float]) -> None:
    now_s = 0.0
    rates, limited = Rates(lambda: now_s), key("robot", rate, burst)
    let_in = 0
    for pause in pauses:
        now_s += pause
        let_in += may(rates, limited)
        assert let_in <= burst + rate * now_s + 1e-6
    waited = [error for error in [refusal(rates, limited)] if error is not None]
    for error in waited:
        now_s += error.retry_after_s + 1e-9
        assert may(rates, limited)


def refusal(rates: Rates, limited: ApiKey) -> TooManyRequests | None:
    for _ in range(30):
        try:
            rates.take([limited])
        except TooManyRequests as error:
            return error
    return None


def test_a_request_counts_to_all_its_keys_or_to_none() -> None:
    rates = Rates(lambda: 0.0)
    handed, holder = key("handed", 1, 5), key("holder", 1, 2)
    assert may(rates, handed, holder)
    assert may(rates, holder)
    assert not any(may(rates, handed, holder) for _ in range(9))
    assert [may(rates, handed) for _ in range(5)] == [True] * 4 + [False]


def test_whose_rate_is_not_limited_is_never_refused() -> None:
    assert all(may(Rates(), key("robot", None)) for _ in range(100))


@pytest.fixture(scope="module")
def limited(serve):
    """The address of a service, and keys to it: one that may ask twice at once, and one that may ask as it likes."""
    running = serve(keys=KeyPolicy.ALWAYS)
    store = KeyStore(running.settings.data_dir)
    slow = store.create("slow", Scope.MAP, limits=KeyLimits(requests_per_s=0.001, burst=3))
    return running.url, slow, store.create("quick", Scope.READ)


def test_who_asks_too_often_is_told_when_to_come_back(limited) -> None:
    url, slow, quick = limited
    with httpx.Client(base_url=url, headers={"Authorization": f"Bearer {slow}"}) as client:
        handed = client.post("/v1/keys", json={"scope": "read"}).json()["key"]
        assert client.get("/v1/maps").status_code == 200
        assert httpx.get(f"{url}/v1/maps", headers={"Authorization": f"Bearer {handed}"}).status_code == 200
        for secret in (slow, handed):  # which counts to the key that handed it on
            refused = client.get("/v1/maps", headers={"Authorization": f"Bearer {secret}"})
            assert (refused.status_code, refused.json()["code"]) == (429, "too_many_requests")
            assert 1 <= int(refused.headers["Retry-After"]) <= 1000
        assert client.get("/healthz").status_code == 200
    for _ in range(5):
        assert httpx.get(f"{url}/v1/maps", headers={"Authorization": f"Bearer {quick}"}).status_code == 200
