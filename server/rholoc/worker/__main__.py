"""A server's worker process: reads its configuration from standard input and ends when that closes."""

import sys
import threading

from rholoc.errors import RholocError
from rholoc.logs import configure_process_logs
from rholoc.processes.program import call_when_input_ends
from rholoc.worker.setup import WorkerSetup
from rholoc.worker.worker import run_worker


def main() -> None:
    """Work until the server closes standard input, on purpose or by dying. Exits with a message if it cannot start."""
    configure_process_logs()
    setup = WorkerSetup.from_line(sys.stdin.buffer.readline())
    stop = threading.Event()
    call_when_input_ends(stop.set)
    try:
        run_worker(setup, stop=stop)
    except RholocError as error:
        sys.exit(f"{error.message} {error.hint}")


if __name__ == "__main__":
    main()
