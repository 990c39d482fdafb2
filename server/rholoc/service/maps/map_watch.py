"""A low-priority thread that keeps the index of all maps' views up to date."""

import logging
import threading

from rholoc.localization import MapFinder
from rholoc.service.threads.niceness import make_thread_nice

_EVERY_S = 1.0
_STOP_S = 5.0
_NICENESS = 10  # of the thread, where the system has that: requests come first
_log = logging.getLogger("rholoc.service")


class MapWatch:
    """A thread that refreshes the index of all maps' views every second.

    Args:
        finder: to refresh.
    """

    def __init__(self, finder: MapFinder) -> None:
        self._finder = finder
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="map-watch", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread within 5 s, and close the finder; a thread that waits for a silent storage is left."""
        self._stopped.set()
        self._thread.join(_STOP_S)
        if not self._thread.is_alive():
            self._finder.close()

    def _run(self) -> None:
        """Refresh every second until stopped; errors are logged."""
        make_thread_nice(_NICENESS)
        said = ""
        while not self._stopped.is_set():
            try:
                self._finder.refresh(self._stopped.is_set)
            except Exception:
                _log.exception("map_index_failed")
            if self._finder.trouble not in ("", said):
                said = self._finder.trouble
                _log.warning("map_index_not_stored", extra={"error": said[:200]})
            self._stopped.wait(_EVERY_S)
