"""Who is let in: keys and their scopes, requests of other sites, the headers of every answer."""

import asyncio
from contextlib import suppress

import httpx
import pytest
from fastapi import APIRouter

from rholoc.errors import Conflict, InvalidName, NotFound
from rholoc.library.folder_documents import FolderDocuments
from rholoc.service.access.guard import Guard, check_query, check_same_site
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.access.scopes import NEEDS_MAP, Access, RouteAccess
from rholoc.service.errors import CrossSite, InvalidRequest
from rholoc.service.errors import Unauthorized as KeyRefused
from rholoc.service.settings import KeyPolicy, keys_needed
from rholoc.service.threads.storage import StorageLanes
from rholoc_client import Client, Forbidden, Unauthorized
from waiting import until


@pytest.fixture(scope="module")
def keys(locked):
    return KeyStore(locked.settings.data_dir)


def bearer(secret):
    return {"Authorization": f"Bearer {secret}"}


def test_a_key_is_found_by_its_secret_alone_and_only_its_hash_is_kept(tmp_path):
    store = KeyStore(tmp_path)
    secret = store.create("robot", Scope.LOCALIZE)
    found = store.find(secret)
    assert (found.name, found.scope, found.expires, found.expired) == ("robot", Scope.LOCALIZE, None, False)
    assert store.find(secret[:-1]) is None
    assert store.keys() == [found]
    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert all(secret not in path.name and secret.encode() not in path.read_bytes() for path in written)


def test_names_of_keys_are_unique_and_printable(tmp_path):
    store = KeyStore(tmp_path)
    store.create("<b>robot</b>", Scope.READ)
    with pytest.raises(Conflict):
        store.create("<b>robot</b>", Scope.ADMIN)
    for name in ("", "a\nb", "x" * 65):
        with pytest.raises(InvalidName):
            store.create(name, Scope.READ)
    with pytest.raises(NotFound):
        store.revoke("robot")


def test_keys_are_asked_for_where_others_can_reach_the_server():
    assert not any(keys_needed(KeyPolicy.AUTO, host) for host in ("127.0.0.1", "::1", "localhost"))
    assert all(keys_needed(KeyPolicy.AUTO, host) for host in ("0.0.0.0", "::", "192.168.1.4", "rho.example"))
    assert keys_needed(KeyPolicy.ALWAYS, "127.0.0.1")
    assert not keys_needed(KeyPolicy.NEVER, "0.0.0.0")


def query(path, names, text):
    route = RouteAccess(path, frozenset({"GET"}), Access(None), frozenset(names), parses_body=False, context=None)
    check_query({"type": "http", "query_string": text}, route)


def test_a_query_may_have_the_names_that_the_route_takes_and_no_other():
    query("/v1/maps", {"limit", "before"}, b"limit=3&before=7&limit=4")
    query("/v1/maps", set(), b"")
    query("/docs", set(), b"limt=3")  # a page's address may carry anything
    with pytest.raises(InvalidRequest, match="'limt'") as refused:
        query("/v1/maps", {"limit", "before"}, b"limit=3&limt=3")
    assert refused.value.hint == "It takes: before, limit."
    with pytest.raises(InvalidRequest) as refused:
        query("/v1/maps", set(), b"x" * 1000 + b"=1")
    assert refused.value.hint == "It takes: none."
    assert "x" * 64 in refused.value.message
    assert "x" * 65 not in refused.value.message


@pytest.mark.parametrize(
    ("headers", "refused"),
    [
        ({"host": "attacker.example"}, True),
        ({"host": "[::1"}, True),
        ({}, True),
        ({"host": "localhost:8080"}, False),
        ({"host": "[::1]:8080"}, False),
        ({"host": "evil.localhost"}, True),
        ({"host": "localhost", "origin": "http://localhost"}, False),
        ({"host": "localhost", "origin": "http://attacker.example"}, True),
        ({"host": "localhost", "origin": "http://attacker.example", "sec-fetch-site": "same-origin"}, False),
        ({"host": "localhost", "sec-fetch-site": "cross-site"}, True),
        ({"host": "localhost", "sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}, False),
    ],
)
def test_a_server_for_one_machine_knows_who_asks(headers, refused):
    if refused:
        with pytest.raises(CrossSite):
            check_same_site("GET", headers, local_only=True)
    else:
        check_same_site("GET", headers, local_only=True)


def test_another_site_may_link_but_not_send():
    headers = {"host": "rho.example", "sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}
    check_same_site("GET", headers, local_only=False)
    with pytest.raises(CrossSite):
        check_same_site("POST", headers, local_only=False)


@pytest.mark.parametrize("authorization", ["", "Bearer", "Basic {secret}", "{secret}", "Bearer my {secret}"])
def test_only_a_bearers_key_counts(locked, keys, request, authorization):
    secret = keys.create(request.node.name, Scope.READ)
    headers = {"Authorization": authorization.format(secret=secret)}
    answer = httpx.get(locked.url + "/v1/maps", headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")
    assert httpx.get(locked.url + "/v1/maps", headers={"Authorization": f"bEARER {secret}"}).status_code == 200


def test_without_a_good_key_nothing_is_reported(locked, keys):
    expired = keys.create("expired", Scope.ADMIN, lifetime_s=0)
    for headers in ({}, bearer("rho_guess"), bearer(expired), {"Authorization": "Basic eDp5"}):
        answer = httpx.get(f"{locked.url}/v1/maps", headers=headers)
        assert answer.status_code == 401
        assert answer.json()["code"] == "unauthorized"
        assert answer.headers["WWW-Authenticate"] == "Bearer"
        assert "room" not in answer.text
    assert httpx.get(f"{locked.url}/healthz").is_success
    assert httpx.get(f"{locked.url}/").is_success


def test_a_key_does_what_its_scope_says_until_it_is_revoked(locked, keys, picture_world):
    secret = keys.create("robot", Scope.LOCALIZE)
    with Client(locked.url, api_key=secret) as client:
        assert [one.name for one in client.maps()] == ["room"]
        assert client.localize("room", picture_world.png(), dof=6).localized
        with pytest.raises(Forbidden):
            client.delete_map("room")
        keys.revoke("robot")
        until(lambda: refused(client))


def refused(client):
    with suppress(Unauthorized):
        client.maps()
        return False
    return True


def test_a_key_that_is_revoked_in_the_middle_of_an_upload_sends_no_more_of_it(locked, keys, picture_world):
    secret = keys.create("sender", Scope.MAP)
    content = picture_world.rho()

    def parts():
        yield content[:1000]
        keys.revoke("sender")
        until(lambda: httpx.get(f"{locked.url}/v1/maps", headers=bearer(secret)).status_code == 401)
        yield content[1000:2000]
        yield content[2000:]

    with suppress(httpx.TransportError):  # the server answers before all is sent
        answer = httpx.put(f"{locked.url}/v1/maps/sent", content=parts(), headers=bearer(secret))
        assert answer.status_code == 401
        assert "revoked" in answer.json()["message"]
    assert not (locked.settings.maps_dir / "sent.rho").exists()


def test_the_last_part_of_a_body_needs_a_valid_key_as_well(tmp_path):
    keys, lanes, router, received = KeyStore(tmp_path), StorageLanes(), APIRouter(), []
    router.add_api_route("/kept", lambda: None, methods=["PUT"], dependencies=[NEEDS_MAP])
    secret = keys.create("sender", Scope.MAP)

    async def receive():
        if received:
            keys.revoke("sender")
        return {"type": "http.request", "body": b"part", "more_body": not received}

    async def keep(scope, receive, send):
        while True:
            received.append(await receive())

    guard = Guard(keep, router.routes, keys, lanes, KeyPolicy.ALWAYS, "127.0.0.1")
    headers = [(b"authorization", f"Bearer {secret}".encode())]
    request = {"type": "http", "method": "PUT", "path": "/kept", "query_string": b"", "headers": headers}
    with pytest.raises(KeyRefused, match="revoked"):
        asyncio.run(guard(request, receive, None))
    assert len(received) == 1
    lanes.close()


def test_an_admin_may_delete(locked, keys, picture_world):
    with Client(locked.url, api_key=keys.create("boss", Scope.ADMIN)) as client:
        client.upload_map("gone", picture_world.rho())
        client.delete_map("gone")
        assert [one.name for one in client.maps()] == ["room"]


@pytest.mark.parametrize(
    "headers",
    [
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
        {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "cors"},
        {"Origin": "https://elsewhere.example"},
        {"Origin": "null"},
        {"Origin": "http://["},
        {"Host": "elsewhere.example"},
        {"Host": "["},
    ],
)
def test_other_sites_are_refused(service, headers):
    answer = httpx.post(f"{service.url}/v1/maps/room/forget", json={"source": "walk"}, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "cross_site")


def test_the_own_page_programs_and_links_are_not(service):
    own = {"Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors", "Origin": service.url}
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    for headers in (own, {"Origin": service.url}, link, {}):
        assert httpx.get(f"{service.url}/", headers=headers).is_success
    posted = httpx.post(f"{service.url}/v1/maps", headers={**link, "Sec-Fetch-Dest": "document"})
    assert posted.json()["code"] == "cross_site"
    typed = httpx.post(f"{service.url}/v1/maps/room", headers={"Sec-Fetch-Site": "none"})  # not sent by any site
    assert (typed.status_code, typed.json()["code"]) == (405, "method_not_allowed")
    assert "PUT" in typed.headers["Allow"]


def test_a_server_for_others_answers_to_any_name(locked, keys):
    headers = {"Host": "maps.example", **bearer(keys.create("reader", Scope.READ))}
    assert httpx.get(f"{locked.url}/v1/maps", headers=headers).is_success


@pytest.mark.parametrize("path", ["/", "/v1/maps", "/web/shared/api.js", "/nothing"])
def test_every_answer_tells_the_browser_to_be_careful(service, path):
    headers = httpx.get(service.url + path).headers
    policy = dict(part.strip().split(" ", 1) for part in headers["Content-Security-Policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == "'self'"
    assert policy["frame-ancestors"] == "'none'"
    assert headers["X-Content-Type-Options"] == "nosniff"


def test_the_pages_files_are_kept_and_asked_about(service):
    first = httpx.get(f"{service.url}/web/shared/api.js")
    assert first.headers["Cache-Control"] == "no-cache"
    again = httpx.get(f"{service.url}/web/shared/api.js", headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    for path in (
        "/web/nothing.js",
        "/js/nothing.js",
        "/web/../app.py",
        "/js/../pyproject.toml",
        "/web/%2e%2e/%2e%2e/pyproject.toml",
    ):
        assert httpx.get(service.url + path).json()["code"] == "unknown_route"


def test_keys_are_found_in_memory(tmp_path, monkeypatch):
    store = KeyStore(tmp_path)
    secrets = {f"robot-{i}": store.create(f"robot-{i}", Scope.LOCALIZE) for i in range(20)}
    read, really = [], FolderDocuments.read
    monkeypatch.setattr(FolderDocuments, "read", lambda folder, name: read.append(name) or really(folder, name))
    for name, secret in secrets.items():
        assert store.find(secret).name == name
    assert store.find("another") is None
    assert not read
