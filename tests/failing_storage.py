"""An S3 server that fails when it is told to."""

import threading
import time
from enum import StrEnum
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import httpx

_SLOW_S = 1.0


class StorageFault(StrEnum):
    """How it fails."""

    GONE = "gone"  # connections are closed without an answer
    SILENT = "silent"  # there is no answer until the fault is over
    SLOW = "slow"  # answers come a second late
    UNAVAILABLE = "unavailable"  # 503
    TRUNCATES = "truncates"  # objects break off half-way


class FailingStorage:
    """A proxy before an S3 server, which fails as it is told to."""

    def __init__(self, upstream: str) -> None:
        self.fault: StorageFault | None = None
        storage = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def _pass_on(self) -> None:
                body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
                if storage.fault is StorageFault.GONE:
                    self.close_connection = True
                    return
                while storage.fault is StorageFault.SILENT:
                    time.sleep(0.05)
                if storage.fault is StorageFault.SLOW:
                    time.sleep(_SLOW_S)
                if storage.fault is StorageFault.UNAVAILABLE:
                    self._answer(503, {}, b"")
                    return
                headers = {name: value for name, value in self.headers.items() if name.lower() != "connection"}
                answer = httpx.request(self.command, upstream + self.path, content=body, headers=headers)
                self._answer(answer.status_code, answer.headers, answer.content)

            do_GET = do_PUT = do_POST = do_DELETE = do_HEAD = _pass_on

            def _answer(self, status: int, headers: Any, content: bytes) -> None:
                length = headers.get("Content-Length", len(content)) if self.command == "HEAD" else len(content)
                self.send_response(status)
                for name, value in headers.items():
                    if name.lower() not in ("content-length", "connection", "transfer-encoding", "content-encoding"):
                        self.send_header(name, value)
                self.send_header("Content-Length", str(length))
                self.end_headers()
                if storage.fault is StorageFault.TRUNCATES and self.command == "GET" and len(content) > 1:
                    content, self.close_connection = content[: len(content) // 2], True
                if self.command != "HEAD":
                    self.wfile.write(content)

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        self.url = f"http://127.0.0.1:{self._server.server_port}"

    def close(self) -> None:
        """End it."""
        self._server.shutdown()
        self._server.server_close()
