"""A server's worker process: reads its configuration from standard input and ends when that closes."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path

from rholoc.errors import RholocError
from rholoc.jobs.capacity import Capacity
from rholoc.logs import configure_process_logs
from rholoc.processes import call_when_input_ends
from rholoc.worker.build_process import BuildLimits
from rholoc.worker.worker import run_worker


def main() -> None:
    """Work until the server closes the pipe, on purpose or by dying."""
    configure_process_logs()
    data_dir, maps_dir, database_url, storage_url, capacity, limits = json.loads(sys.stdin.buffer.readline())
    stop = threading.Event()
    call_when_input_ends(stop.set)
    try:
        run_worker(
            Path(data_dir),
            Path(maps_dir),
            database_url,
            limits=BuildLimits(*limits),
            stop=stop,
            storage_url=storage_url,
            capacity=Capacity(*capacity),
        )
    except RholocError as error:
        sys.exit(f"{error.message} {error.hint}")


if __name__ == "__main__":
    main()
