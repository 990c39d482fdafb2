"""The requests that `benchmarks/fuzz.py` damages: of every route and stream, and accepted until they are damaged."""

import asyncio
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import fuzz
from fuzz_requests import World, further_requests, good_requests, prepared
from rholoc.service import Settings, create_app
from rholoc.service.access.scopes import route_access

REFUSED = {  # for want of a second walk, of many queries, of pictures, of a worker, of an open stream
    "POST /v1/maps/{map_name}/merge": 409,
    "POST /v1/maps/{map_name}/forget": 409,
    "POST /v1/maps/{map_name}/learn": 409,
    "GET /v1/maps/{map_name}/views/{view}/picture.jpg": 404,
    "GET /v1/recordings/{recording}/thumbnail.jpg": 404,
    "GET /v1/maps/{map_name}/refusals/{number}": 404,
    "GET /v1/maps/{map_name}/refusals/{number}/picture.jpg": 404,
    "DELETE /v1/streams/{stream}": 404,
}
pytestmark = pytest.mark.slow
WORLD = World(*("0" * 32 for _ in range(4)), key="guest")


def test_requests_of_every_route_and_streams_of_every_kind_are_damaged():
    app = create_app(Settings())
    operations = fuzz.Operations(app.openapi(), seed=0)
    labels = {*operations.labels(streams=False), *operations.labels(streams=True)}
    assert set(further_requests(WORLD)) <= labels
    assert all(good_requests(WORLD, label) for label in labels)
    sockets = [route.path for route in route_access(app.routes) if not route.methods]
    assert [f"WEBSOCKET {path}" for path in sockets] == [fuzz.TRACK]


def test_requests_are_accepted_before_they_are_damaged(tmp_path, monkeypatch):
    for name, value in fuzz.SETTINGS.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("rholoc.service.http.boundary._REFUSAL_TAKES_S", 0.0)
    wrong = asyncio.run(refused(tmp_path))
    assert wrong == []


async def refused(folder: Path) -> list[str]:
    """The good requests that are not answered as they should be."""
    wrong = []
    async with fuzz.application(folder) as client:

        async def send(one):
            return await client.send(one.built(client))

        operations = fuzz.Operations(create_app().openapi(), seed=0)
        world = await prepared(send)
        for label in (one for one in operations.labels(streams=False) if one not in fuzz.DRAWN):  # those take long
            for number in range(len(good_requests(world, label))):
                answer = await send(good_requests(world, label)[number])
                complaint = operations.judge(label, answer)
                if not (answer.is_success or answer.status_code == REFUSED.get(label)) or complaint:
                    wrong.append(f"{label} {number}: {answer.status_code} {answer.text[:300]} {complaint}")
                if not label.startswith("GET"):
                    world = await prepared(send, world)
    return wrong
