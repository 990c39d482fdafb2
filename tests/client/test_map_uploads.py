"""A map that is uploaded over a line that loses answers replaces the map before it once."""

import asyncio
import contextlib
import hashlib
import socket
import threading
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np
import pytest

from rholoc.library.recordings import RecordingStore
from rholoc_client import AsyncClient, Client, ConnectionFailed, MapSummary, ServiceError

RHO = (2).to_bytes(8, "little") + b"{}" + b"the arrays"
OTHER = (2).to_bytes(8, "little") + b"{}" + b"others"
SUMMARY = {
    "name": "hall", "id": "i", "version": 1, "density": "ray", "features": "sift48", "scale": "metric", "upright": True,
    "created": "2026-01-01T00:00:00+00:00", "landmarks": 1, "views": 1, "size_bytes": 9, "trusted": True,
    "trust_reason": "", "camera": {"fx": 1, "fy": 1, "cx": 1, "cy": 1, "width": 2, "height": 2, "distortion": []},
}  # fmt: skip


@dataclass
class Server:
    """Keeps one map with its versions, as the service does, and loses answers to the PUTs numbered in ``lost``."""

    lost: set[int]
    before: bytes | None = None
    with_etags: bool = True
    arrives: bool = True
    versions: list[bytes] = field(default_factory=list)
    conditions: list[tuple[str | None, str | None]] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.before is not None:
            self.versions.append(self.before)

    @property
    def etag(self) -> str:
        return f'"{len(self.versions)}"'

    def __call__(self, request: httpx.Request) -> httpx.Response:
        headers = {"ETag": self.etag} if self.with_etags else {}
        if request.method == "PUT":
            return self._put(request)
        if not self.versions:
            return httpx.Response(404, json={"code": "unknown_map", "message": "No.", "hint": "", "request_id": "r"})
        if request.url.path.endswith("/download"):
            return httpx.Response(200, content=self.versions[-1], headers=headers)
        return httpx.Response(200, json=SUMMARY, headers=headers)

    def _put(self, request: httpx.Request) -> httpx.Response:
        match, none_match = request.headers.get("If-Match"), request.headers.get("If-None-Match")
        self.conditions.append((match, none_match))
        lost = len(self.conditions) in self.lost
        refused = match not in (None, self.etag) or (none_match == "*" and bool(self.versions))
        if not refused and (self.arrives or not lost):
            self.versions.append(request.content)
        if lost:
            raise httpx.ReadError("cut", request=request)
        body = {"code": "precondition_failed", "message": "It has changed.", "hint": "", "request_id": "r"}
        return httpx.Response(412, json=body) if refused else httpx.Response(201, json=SUMMARY)


def upload(kind: str, server: Server, source: Path | str | bytes = RHO) -> MapSummary:
    transport = httpx.MockTransport(server)
    if kind == "sync":
        with Client("http://service", transport=transport) as client:
            return client.upload_map("hall", source)

    async def send() -> MapSummary:
        async with AsyncClient("http://service", transport=transport) as client:
            return await client.upload_map("hall", source)

    return asyncio.run(send())


@pytest.mark.parametrize("kind", ["sync", "async"])
@pytest.mark.parametrize("with_etags", [True, False])
@pytest.mark.parametrize("before", [None, OTHER])
def test_a_map_that_arrived_is_not_sent_again(kind: str, with_etags: bool, before: bytes | None) -> None:
    server = Server({1, 2, 3, 4, 5}, before, with_etags)
    assert upload(kind, server).name == "hall"
    assert server.conditions == [(None, None)]
    assert server.versions[-1] == RHO


@pytest.mark.parametrize(("before", "condition"), [(OTHER, ('"1"', None)), (None, (None, "*"))])
def test_a_map_that_did_not_arrive_is_sent_again_on_the_condition_that_it_still_has_not(
    before: bytes | None, condition: tuple[str | None, str | None]
) -> None:
    server = Server({1}, before, arrives=False)
    assert upload("sync", server).name == "hall"
    assert server.conditions == [(None, None), condition]
    assert server.versions[-1] == RHO


@pytest.mark.parametrize("before", [None, OTHER])
def test_a_map_that_arrives_while_it_is_sent_again_is_there_once(before: bytes | None) -> None:
    """The first request is still at work when the client looks, and done when the second arrives."""

    class Late(Server):
        def _put(self, request: httpx.Request) -> httpx.Response:
            if len(self.conditions) == 1:
                self.versions.append(RHO)
            return super()._put(request)

    server = Late({1}, before, arrives=False)
    assert upload("sync", server).name == "hall"
    assert server.versions.count(RHO) == 1


def test_a_line_that_loses_every_answer_is_given_up() -> None:
    server = Server(set(range(100)), OTHER, arrives=False)
    with pytest.raises(ConnectionFailed):
        upload("sync", server)
    assert len(server.conditions) == 5


def test_a_table_is_sent_once_for_nothing_shows_whether_it_arrived() -> None:
    server = Server({1}, OTHER)
    with pytest.raises(ConnectionFailed):
        upload("sync", server, b"channel,descriptor,x,y,z\n")
    assert len(server.conditions) == 1


def test_an_error_is_the_answer() -> None:
    def refuse(_: httpx.Request) -> httpx.Response:
        return httpx.Response(422, json={"code": "invalid_map", "message": "No.", "hint": "", "request_id": "r"})

    with pytest.raises(ServiceError), Client("http://service", transport=httpx.MockTransport(refuse)) as client:
        client.upload_map("hall", RHO)


@pytest.mark.parametrize("kind", ["sync", "async"])
def test_a_file_may_be_named_by_a_text(kind: str, tmp_path: Path) -> None:
    (tmp_path / "room.rho").write_bytes(RHO)
    server = Server(set())
    upload(kind, server, str(tmp_path / "room.rho"))
    assert server.versions == [RHO]


LENGTH = 60_000_000
CUTS = [5_000_000, 17_000_000, 18_000_000, 40_000_000, 59_000_000]


class BreakingLine:
    """Passes bytes on to the service; breaks once so many came from the client in all."""

    def __init__(self, address: tuple[str, int], cuts: list[int]) -> None:
        self.cuts = list(cuts)
        self._address = address
        self._passed = 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            service = socket.create_connection(self._address)
            threading.Thread(target=self._pass, args=(service, client, False), daemon=True).start()
            threading.Thread(target=self._pass, args=(client, service, True), daemon=True).start()

    def _pass(self, source: socket.socket, sink: socket.socket, counted: bool) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if counted:
                    self._passed += len(data)
                    if self.cuts and self._passed > self.cuts[0]:
                        self.cuts.pop(0)
                        break
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


class Watching(httpx.HTTPTransport):
    """Checks that every piece begins where the service said that it stands."""

    acknowledged = 0
    sent = 0

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        if request.method == "PATCH":
            assert int(request.headers["Upload-Offset"]) == self.acknowledged
            self.sent += len(request.content)
        response = super().handle_request(request)
        self.acknowledged = int(response.headers.get("Upload-Offset", self.acknowledged))
        return response


@pytest.mark.slow
def test_a_connection_that_is_cut_five_times(service, tmp_path):
    content = b"\0\0\0\x18ftypmp42" + np.random.default_rng(1).bytes(LENGTH - 12)
    (tmp_path / "walk.mp4").write_bytes(content)
    line, watching = BreakingLine(service.address, CUTS), Watching()
    with Client(line.url, transport=watching) as client:
        job = client.upload_recording(tmp_path / "walk.mp4", "hall")
        client.cancel_job(job.id)
    line.close()
    assert line.cuts == []
    stored = RecordingStore(service.settings.data_dir).path(job.recording).read_bytes()
    assert hashlib.sha256(stored).digest() == hashlib.sha256(content).digest()
    assert watching.acknowledged == LENGTH
    assert LENGTH < watching.sent <= LENGTH + len(CUTS) * 4 * 2**20, "only pieces that were cut are sent again"
