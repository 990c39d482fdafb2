"""The worker beside a server: its configuration and its end come through the standard input."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path

from rholoc.jobs.build_process import Limits
from rholoc.jobs.worker import run_worker
from rholoc.logs import configure_process_logs


def main() -> None:
    """Work until the server closes the pipe, on purpose or by dying."""
    configure_process_logs()
    data_dir, maps_dir, database_url, *limits = json.loads(sys.stdin.buffer.readline())
    stop = threading.Event()
    threading.Thread(target=_wait_for_end, args=(stop,), daemon=True).start()
    run_worker(Path(data_dir), Path(maps_dir), database_url, limits=Limits(*limits), stop=stop)


def _wait_for_end(stop: threading.Event) -> None:
    while sys.stdin.buffer.read(1):
        pass
    stop.set()


if __name__ == "__main__":
    main()
