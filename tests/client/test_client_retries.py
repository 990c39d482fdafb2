"""When the client asks again, and when it must not. The service is played by a transport."""

import asyncio

import httpx
import pytest

from rholoc_client import (
    AsyncClient,
    Busy,
    Client,
    ConnectionFailed,
    Internal,
    InvalidAnswer,
    QuotaExceeded,
    ServiceError,
    TooManyRequests,
)

JOB = {
    "id": "1" * 32, "recording": "2" * 32, "map": "hall", "state": "queued", "stage": "received", "progress": 0.0,
    "message": "", "log": [], "error": None, "created": 1.0, "started": None, "ended": None, "attempts": 0,
}  # fmt: skip


def busy(retry_after: str | None = "1") -> httpx.Response:
    body = {"code": "busy", "message": "Too much to do.", "hint": "Later.", "request_id": "r"}
    return httpx.Response(503, json=body, headers={} if retry_after is None else {"Retry-After": retry_after})


class Script:
    """Answers one after the other; an exception is raised instead."""

    def __init__(self, *answers):
        self.answers = list(answers)
        self.requests: list[httpx.Request] = []

    def __call__(self, request: httpx.Request) -> httpx.Response:
        request.read()
        self.requests.append(request)
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            answer.request = request
            raise answer
        return answer


@pytest.fixture
def slept(monkeypatch):
    """The seconds that the client would have slept."""
    seconds: list[float] = []

    async def sleep(wait_s):
        seconds.append(wait_s)

    monkeypatch.setattr("rholoc_client._sync.client.time.sleep", seconds.append)
    monkeypatch.setattr("rholoc_client._async.client.asyncio.sleep", sleep)
    return seconds


def client(script, **options):
    return Client("http://service", transport=httpx.MockTransport(script), **options)


def maps() -> httpx.Response:
    return httpx.Response(200, json={"maps": [], "unreadable": {}})


def job() -> httpx.Response:
    return httpx.Response(202, json=JOB)


def test_a_busy_service_is_asked_again_after_what_it_says(slept):
    script = Script(busy("3"), busy("0"), maps())
    assert client(script).maps() == []
    assert slept[0] == 3
    assert 0.2 <= slept[1] <= 0.4


def limited(code: str, retry_after: str) -> httpx.Response:
    body = {"code": code, "message": "Too much.", "hint": "", "request_id": "r"}
    return httpx.Response(429, json=body, headers={"Retry-After": retry_after})


def test_a_key_that_asks_too_often_asks_again_when_it_is_told_to(slept):
    assert client(Script(limited("too_many_requests", "2"), maps())).maps() == []
    assert slept == [2]
    for code, kind in (("too_many_requests", TooManyRequests), ("quota_exceeded", QuotaExceeded)):
        with pytest.raises(kind):
            client(Script(limited(code, "600"))).maps()
    assert slept == [2]


def test_waits_double_and_are_scattered(slept):
    for _ in range(20):
        with pytest.raises(Busy):
            client(Script(*[busy("0")] * 5)).maps()
    for attempt in range(4):
        waits = slept[attempt::4]
        assert all(0.1 * 2**attempt <= wait <= 0.2 * 2**attempt for wait in waits)
        assert len(set(waits)) > 1


def test_in_the_end_it_is_busy(slept):
    with pytest.raises(Busy) as caught:
        client(Script(busy(), busy()), retries=1).maps()
    assert (caught.value.code, caught.value.status, caught.value.request_id) == ("busy", 503, "r")
    assert "Later." in str(caught.value)


def test_a_strange_retry_after_does_no_harm(slept):
    assert client(Script(busy("Wed, 21 Oct 2015 07:28:00 GMT"), busy("1e9"), busy(None), maps())).maps() == []
    assert max(slept) <= 60


def test_a_broken_connection_is_tried_again_where_that_does_no_harm(slept):
    assert client(Script(httpx.ReadError("cut"), httpx.ReadTimeout("slow"), maps())).maps() == []


def test_what_was_perhaps_done_is_not_done_twice(slept):
    script = Script(httpx.ReadError("cut"), job())
    with pytest.raises(ConnectionFailed, match="cut"):
        client(script).retry_job("1")
    assert len(script.requests) == 1


def test_what_was_never_sent_is_sent_again(slept):
    assert client(Script(httpx.ConnectError("refused"), busy(), job())).retry_job("1").map == "hall"


def read_timeouts_s(script) -> list[float]:
    return [request.extensions["timeout"]["read"] for request in script.requests]


def test_an_answer_is_awaited_until_its_deadline(slept):
    script = Script(httpx.Response(200, json={}), httpx.Response(200, json={}))
    for deadline_ms in (None, 25_000):
        with pytest.raises(InvalidAnswer):
            client(script, timeout_s=3).localize("hall", b"jpeg", deadline_ms=deadline_ms)
    assert read_timeouts_s(script) == [3, 28]
    assert {request.extensions["timeout"]["connect"] for request in script.requests} == {3}
    with pytest.raises(InvalidAnswer):
        client(script := Script(httpx.Response(200, json={})), timeout_s=None).localize("hall", b"jpeg", deadline_ms=9)
    assert read_timeouts_s(script) == [None]


@pytest.mark.parametrize(
    "ask",
    [
        lambda asked: asked.find_site_link("campus", "a", "b"),
        lambda asked: asked.merge_maps("a", "b", "c"),
        lambda asked: asked.correct_map("a", {"kind": "up"}),
        lambda asked: asked.forget_recording("a", "walk"),
        lambda asked: asked.download_map("a", "csv", degree=3),
    ],
)
def test_what_takes_minutes_is_awaited_and_asked_once(slept, ask):
    script = Script(httpx.ReadTimeout("slow"))
    with pytest.raises(ConnectionFailed):
        ask(client(script))
    assert read_timeouts_s(script)[0] > 120


def stands_at(offset: int, status: int = 204, **headers: str) -> httpx.Response:
    return httpx.Response(status, headers={"Upload-Offset": str(offset), **headers})


def upload(script, folder, **options):
    (folder / "walk.mp4").write_bytes(b"0123456789" * 1000)
    begun = httpx.Response(201, headers={"Location": "http://elsewhere/v1/recordings/" + "2" * 32})
    script.answers = [begun, *script.answers]
    return client(script, **options).upload_recording(folder / "walk.mp4", "hall")


def test_after_a_broken_connection_the_upload_goes_on_where_the_service_is(slept, tmp_path):
    whole = stands_at(10_000, **{"Rholoc-Job": JOB["id"]})
    script = Script(busy(), httpx.ReadError("cut"), stands_at(4000, 200), whole, job())
    assert upload(script, tmp_path).id == JOB["id"]
    asked = [
        (request.method, request.headers.get("Upload-Offset"), len(request.content)) for request in script.requests
    ]
    assert asked[1:5] == [("PATCH", "0", 10_000)] * 2 + [("HEAD", None, 0), ("PATCH", "4000", 6000)]


def test_an_answer_that_was_lost_costs_no_byte(slept, tmp_path):
    script = Script(httpx.ReadError("cut"), stands_at(10_000, 200, **{"Rholoc-Job": JOB["id"]}), job())
    assert upload(script, tmp_path).id == JOB["id"]
    assert [request.method for request in script.requests] == ["POST", "PATCH", "HEAD", "GET"]


def test_an_upload_that_does_not_come_on_is_given_up(slept, tmp_path):
    script = Script(*[httpx.ReadError("cut"), stands_at(0, 200)] * 3)
    with pytest.raises(ConnectionFailed):
        upload(script, tmp_path, retries=1)
    assert [request.method for request in script.requests] == ["POST", "PATCH", "HEAD", "PATCH"]


def test_errors_that_asking_again_does_not_help_are_not_repeated(slept):
    body = {"code": "internal", "message": "Broken.", "hint": "", "request_id": "r"}
    script = Script(httpx.Response(500, json=body))
    with pytest.raises(Internal):
        client(script).maps()
    assert len(script.requests) == 1
    assert slept == []


def test_readiness_is_an_answer_even_when_it_is_no(slept):
    answer = httpx.Response(503, json={"ready": False, "checks": {"maps": "the folder is missing"}})
    assert client(Script(answer)).readiness() == {"maps": "the folder is missing"}


def test_codes_that_are_not_known_yet_are_service_errors():
    body = {"code": "tomorrow", "message": "New.", "hint": "", "request_id": "r"}
    with pytest.raises(ServiceError) as caught:
        client(Script(httpx.Response(418, json=body))).maps()
    assert caught.value.code == "tomorrow"


@pytest.mark.parametrize(
    "answer", [httpx.Response(200, text="<html>"), httpx.Response(200, json={}), httpx.Response(200, json=[])]
)
def test_what_is_not_the_service_is_reported(answer):
    with pytest.raises(InvalidAnswer):
        client(Script(answer)).maps()


@pytest.mark.parametrize("answer", ["[]", "null", '"here"', '{"camera": "here"}'])
def test_an_answer_of_another_shape_is_not_the_services(answer):
    with pytest.raises(InvalidAnswer):
        client(Script(httpx.Response(200, text=answer))).localize("hall", b"jpeg")


@pytest.mark.parametrize("answer", [httpx.Response(502, text="<html>"), httpx.Response(404, json=["x"])])
def test_errors_of_something_between_are_service_errors(answer):
    with pytest.raises(ServiceError, match="status"):
        client(Script(answer)).maps()


def test_the_api_key_is_a_bearer_token():
    script = Script(maps())
    client(script, api_key="k").maps()
    assert script.requests[0].headers["Authorization"] == "Bearer k"


def test_names_stay_one_segment_of_the_path():
    body = {"code": "invalid_name", "message": "No.", "hint": "", "request_id": "r"}
    for name in ("..", ".", "a/b", "a b", "ä", "?x=1"):
        script = Script(httpx.Response(422, json=body))
        with pytest.raises(ServiceError):
            client(script).map(name)
        assert script.requests[0].url.raw_path.startswith(b"/v1/maps/")
        assert script.requests[0].url.raw_path.count(b"/") == 3
        assert b"?" not in script.requests[0].url.raw_path


def test_the_async_client_does_the_same(slept):
    async def ask(script):
        async with AsyncClient("http://service", transport=httpx.MockTransport(script)) as asking:
            return await asking.maps()

    assert asyncio.run(ask(Script(busy("3"), httpx.ReadError("cut"), maps()))) == []
    assert slept[0] == 3
    with pytest.raises(ConnectionFailed):
        asyncio.run(ask(Script(*[httpx.ReadError("cut")] * 5)))
