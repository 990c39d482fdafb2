"""Threads whose work can wait."""

import os
import sys
import threading


def make_thread_nice(niceness: int) -> None:
    """Let the calling thread run at ``niceness`` (0 to 19: the higher, the later). One that is nicer, as in a service
    that was started with ``nice``, stays so, for only root may raise priorities. Nothing happens but on Linux, the only
    system with priorities per thread.
    """
    if sys.platform == "linux":
        thread = threading.get_native_id()
        os.setpriority(os.PRIO_PROCESS, thread, max(niceness, os.getpriority(os.PRIO_PROCESS, thread)))
