"""Write the blocking client from the one for asyncio: ``python client/write_sync.py``, part of ``make format``."""

import subprocess
import sys
import tempfile
from pathlib import Path

import unasync

_CLIENT = Path(__file__).parent / "rholoc_client"
SYNC_FILE = _CLIENT / "_sync" / "client.py"
_ASYNC_FILE = _CLIENT / "_async" / "client.py"
_NOTE = "# Written by client/write_sync.py from _async/client.py: change that one, and run `make format`.\n"
_NAMES = {
    "AsyncClient": "Client",
    "AsyncBaseTransport": "BaseTransport",
    "aclose": "close",
    "aiter_lines": "iter_lines",
    "aread": "read",
    "asyncio": "time",  # of sleep
}


def sync_source() -> str:
    """Source of the blocking client, formatted."""
    with tempfile.TemporaryDirectory() as folder:
        copy, written = Path(folder) / "_async" / "client.py", Path(folder) / "_sync" / "client.py"
        copy.parent.mkdir()
        copy.write_text(_ASYNC_FILE.read_text(encoding="utf-8"), encoding="utf-8")
        unasync.unasync_files([str(copy)], [unasync.Rule("/_async/", "/_sync/", _NAMES)])
        source = written.read_text(encoding="utf-8")
    for arguments in (["check", "--select=I", "--fix", "--quiet"], ["format", "--quiet"]):
        ruff = [sys.executable, "-m", "ruff", *arguments, "--stdin-filename", str(SYNC_FILE), "-"]
        source = subprocess.run(ruff, input=source, capture_output=True, text=True, check=True).stdout
    return _NOTE + source


if __name__ == "__main__":
    SYNC_FILE.write_text(sync_source(), encoding="utf-8")
