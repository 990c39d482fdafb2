"""A long upload over a line that breaks: what the service has acknowledged is never sent again."""

from __future__ import annotations

import contextlib
import hashlib
import socket
import threading

import httpx
import numpy as np

from rholoc.library import RecordingStore
from rholoc_client import Client

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
