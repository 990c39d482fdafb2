"""Two servers that share a PostgreSQL database and an S3 bucket: they are one service."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from rholoc.library.stores import KEYS
from rholoc.service.access.keys import KeyLimits, KeyStore, Scope
from rholoc.service.settings import KeyPolicy
from waiting import until

BUCKET = "rholoc"
VIDEO = b"\0\0\0\x18ftypmp42" + b"no frames" * 1000
HEARD_WITHIN_S = 20.0  # two seconds, and what a busy machine adds


@pytest.fixture(scope="module")
def s3_url() -> Iterator[str]:
    """An S3 server of our own, with an empty bucket."""
    boto3 = pytest.importorskip("boto3")
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    environment = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_REGION": "us-east-1",
        "AWS_ALLOW_HTTP": "true",
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        boto3.client("s3", region_name="us-east-1").create_bucket(Bucket=BUCKET)
        yield f"s3://{BUCKET}/service"
    server.stop()


@pytest.fixture(scope="module")
def servers(serve: Any, s3_url: str, postgres: Any) -> list[str]:
    """Two services' addresses."""
    urls = {"database_url": postgres.create_database("two_servers"), "storage_url": s3_url}
    return [serve(**urls).url for _ in range(2)]


def metadata(**values: str) -> str:
    return ",".join(f"{name} {base64.b64encode(value.encode()).decode()}" for name, value in values.items())


@pytest.mark.slow
def test_two_servers_are_one_service(servers: list[str], picture_world: Any) -> None:
    here, there = servers
    map_file = picture_world.rho()
    assert httpx.put(f"{here}/v1/maps/hall", content=map_file).status_code == 201
    until(lambda: httpx.get(f"{there}/v1/maps/hall").status_code == 200, HEARD_WITHIN_S)
    answer = httpx.post(
        f"{there}/v1/maps/hall/localize",
        content=picture_world.png(),
        headers={"Content-Type": "image/png"},
        params={"fx": 520, "fy": 520, "cx": 319.5, "cy": 239.5, "dof": 6},
    ).json()
    assert answer["localized"], answer
    assert httpx.get(f"{there}/v1/maps/hall/download").content == map_file
    assert httpx.get(f"{there}/v1/maps/hall/preview.png").headers["Content-Type"] == "image/png"
    assert httpx.patch(f"{there}/v1/maps/hall", json={"name": "lobby"}).status_code == 200
    until(lambda: httpx.get(f"{here}/v1/maps/lobby").status_code == 200, HEARD_WITHIN_S)
    camera = {"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 320, "cy": 240}
    assert httpx.put(f"{here}/v1/cameras/phone", json=camera).status_code == 201
    until(lambda: httpx.get(f"{there}/v1/cameras/phone").status_code == 200, HEARD_WITHIN_S)


@pytest.mark.slow
def test_an_upload_that_lost_its_server_goes_on_at_another(servers: list[str]) -> None:
    here, there = servers
    length, step = len(VIDEO), 4000
    headers = {"Tus-Resumable": "1.0.0", "Upload-Length": str(length)}
    headers["Upload-Metadata"] = metadata(filename="walk.mp4", map="yard")
    begun = httpx.post(f"{here}/v1/recordings", headers=headers)
    assert begun.status_code == 201, begun.text
    path = begun.headers["Location"]
    for number, start in enumerate(range(0, length, step)):
        server = (there, here)[number % 2]
        stands = httpx.head(f"{server}{path}", headers={"Tus-Resumable": "1.0.0"}).headers["Upload-Offset"]
        assert int(stands) == start
        patched = httpx.patch(
            f"{server}{path}",
            content=VIDEO[start : start + step],
            headers={
                "Tus-Resumable": "1.0.0",
                "Upload-Offset": str(start),
                "Content-Type": "application/offset+octet-stream",
            },
        )
        assert patched.status_code == 204, patched.text
    job = httpx.head(f"{here}{path}", headers={"Tus-Resumable": "1.0.0"}).headers["Rholoc-Job"]
    assert [httpx.get(f"{server}/v1/jobs/{job}").json()["map"] for server in servers] == ["yard"] * 2
    listed = [httpx.get(f"{server}/v1/recordings").json()["recordings"] for server in servers]
    assert listed[0] == listed[1]
    assert listed[0][0]["size_bytes"] == length


@pytest.mark.slow
def test_servers_stay_ready_while_the_database_is_gone(serve: Any, tmp_path: Any, postgres: Any) -> None:
    url = serve(database_url=postgres.create_database("gone"), storage_url=f"file://{tmp_path}/storage").url
    answer = httpx.get(f"{url}/readyz")
    assert (answer.status_code, answer.json()["checks"]["maps"], answer.json()["checks"]["jobs"]) == (200, "ok", "ok")
    postgres.stop()
    try:
        answer = httpx.get(f"{url}/readyz")
        assert (answer.status_code, answer.json()["ready"]) == (200, True)
        assert "does not answer" in answer.json()["checks"]["jobs"]
        refused = httpx.put(
            f"{url}/v1/cameras/phone", json={"width": 9, "height": 9, "fx": 9, "fy": 9, "cx": 4, "cy": 4}
        )
        assert (refused.status_code, refused.json()["code"]) == (503, "storage_unavailable")
    finally:
        postgres.start()
    until(lambda: httpx.get(f"{url}/readyz").json()["checks"]["jobs"] == "ok")


@pytest.mark.slow
def test_what_keys_hold_is_counted_together(serve: Any, s3_url: str, postgres: Any, picture_world: Any) -> None:
    urls = {"database_url": postgres.create_database("quotas"), "storage_url": s3_url}
    running = [serve(**urls, keys=KeyPolicy.ALWAYS) for _ in range(2)]
    stores = running[0].settings.stores()
    stores.open()
    secret = KeyStore(stores.documents(KEYS)).create("mapper", Scope.ADMIN, limits=KeyLimits(maps=1))
    stores.close()
    here, there = (httpx.Client(base_url=one.url, headers={"Authorization": f"Bearer {secret}"}) for one in running)
    until(lambda: there.get("/v1/maps").status_code == 200, HEARD_WITHIN_S)
    assert here.put("/v1/maps/one", content=picture_world.rho()).status_code == 201
    until(lambda: there.get("/v1/maps/one").status_code == 200, HEARD_WITHIN_S)
    refused = there.put("/v1/maps/two", content=picture_world.rho())
    assert (refused.status_code, refused.json()["code"]) == (429, "quota_exceeded")
    assert [one["path"] for one in there.get("/v1/audit").json()["changes"]] == ["/v1/maps/one"]
