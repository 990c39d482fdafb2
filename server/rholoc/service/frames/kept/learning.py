"""Keep the features of confident answers for maps to learn from, in a background thread."""

import hashlib
import logging
import queue
import secrets
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from rholoc.errors import RholocError
from rholoc.features import Extractor, FeatureSet
from rholoc.geometry import Camera
from rholoc.library.folder_documents import Documents
from rholoc.library.queries import QueryStore
from rholoc.localization import Localization
from rholoc.mapping.learn.answered_query import AnsweredQuery
from rholoc.service.access.keys import HANDED_PREFIX
from rholoc.service.settings import Settings
from rholoc.service.threads.compute import lower_priority

TEACHES_FROM = 0.8  # minimum confidence
_MAX_WAITING = 8
_STOP_S = 5.0
_SALT_FILE = "askers.salt"
_SALT_BYTES = 16
_log = logging.getLogger("rholoc.service")


@dataclass(frozen=True, eq=False)
class Lesson:
    """An answer that a map may learn from.

    Attributes:
        map_id: of the map that answered.
        extractor: of its features.
        camera: of the frame.
        answer: a confident pose.
        features: extracts the frame's features.
    """

    map_id: str
    extractor: Extractor
    camera: Camera
    answer: Localization
    features: Callable[[Extractor], FeatureSet]


Listener = Callable[[Lesson], None]


class Learner:
    """Stores the features of confident answers. It never delays answers: lessons beyond its capacity are dropped.

    Args:
        store: of the queries.
        settings: whether queries are kept, and whose.
        salts: files with the salt of the askers' pseudonyms, shared with the same servers as the queries.
    """

    def __init__(self, store: QueryStore, settings: Settings, salts: Documents) -> None:
        self.store, self._settings, self._salts = store, settings, salts
        self._barred = {name.strip() for name in settings.learn_not_from.split(",")} - {""}
        self._waiting: queue.Queue[tuple[Lesson, str] | None] = queue.Queue(_MAX_WAITING)
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread that keeps queries, if the settings enable it."""
        if self._settings.learn:
            self._thread = threading.Thread(target=self._keep_all, name="rholoc-learner", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Drop pending lessons and stop the thread, within 5 s."""
        if self._thread is None:
            return
        with suppress(queue.Empty):
            while True:
                self._waiting.get_nowait()
        self._waiting.put(None)
        self._thread.join(_STOP_S)

    def listener(self, asker: str) -> Listener | None:
        """Listener for the answers to ``asker``, a key's name or an address; None if its queries are not kept.

        It takes those of a confidence of at least 0.8, and drops them if 8 are pending.
        """
        if self._thread is None or asker in self._barred:
            return None
        if asker.startswith(HANDED_PREFIX) and not self._settings.learn_from_handed:
            return None

        def listen(lesson: Lesson) -> None:
            answer = lesson.answer
            if answer.pose is None or answer.covariance is None or answer.confidence < TEACHES_FROM:
                return
            with suppress(queue.Full):
                self._waiting.put_nowait((lesson, asker))

        return listen

    @property
    def listens(self) -> bool:
        """Whether queries are kept."""
        return self._thread is not None

    def pseudonym(self, asker: str) -> str:
        """12 hex digits that stand for an asker, irreversible without the salt, which is made on first use.

        Raises:
            StorageFull, InvalidInput: there is no salt yet, and it cannot be stored.
        """
        try:
            salt = self._salts.read(_SALT_FILE)
        except FileNotFoundError:
            self._salts.write(_SALT_FILE, secrets.token_bytes(_SALT_BYTES), called="the salt of pseudonyms")
            salt = self._salts.read(_SALT_FILE)
        return hashlib.blake2b(asker.encode(), key=salt, digest_size=6).hexdigest()

    @property
    def idle(self) -> bool:
        """Whether no lessons are pending."""
        return self._waiting.unfinished_tasks == 0

    def _keep_all(self) -> None:
        """Keep pending lessons one after another until :meth:`close`; errors are logged."""
        lower_priority()
        while (item := self._waiting.get()) is not None:
            try:
                self._keep(*item)
            except RholocError as error:
                _log.warning("query_not_kept", extra={"error": error.message})
            except Exception:
                _log.exception("query_not_kept")
            finally:
                self._waiting.task_done()

    def _keep(self, lesson: Lesson, asker: str) -> None:
        """Store an answer's features as a query of the asker's pseudonym, unless the store does not want it."""
        pose, covariance = lesson.answer.pose, lesson.answer.covariance
        assert pose is not None
        assert covariance is not None
        now, who = time.time(), self.pseudonym(asker)
        if not self.store.wants(lesson.map_id, pose.T_map_camera, who, now):
            return
        query = AnsweredQuery(
            features=lesson.features(lesson.extractor),
            camera=lesson.camera,
            T_map_camera=pose.T_map_camera,
            covariance=covariance,
            confidence=lesson.answer.confidence,
            time_s=now,
            asker=who,
        )
        self.store.add(lesson.map_id, query)
