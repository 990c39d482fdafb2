"""Regular background work: remove expired data, and let maps learn at night."""

import asyncio
import hashlib
import logging
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime

from rholoc.errors import InvalidMap, RholocError, StorageUnavailable, UnknownMap
from rholoc.jobs import JobKind, JobOptions, JobPriority
from rholoc.mapping.learn.from_queries import MIN_QUERIES
from rholoc.service.state import State
from rholoc.service.threads.storage import StorageThreads

_EVERY_S = 600.0
_KEYS_EVERY_S, _KEYS_WITHIN_S = 0.1, 5.0
_DAY_S = 24 * 3600.0
_log = logging.getLogger("rholoc.service")


async def clean_up_regularly(state: State) -> None:
    """Every 10 minutes until cancelled, remove what is expired (:data:`_WORKS`); at night let maps learn."""
    while True:
        for name, work in _WORKS.items():
            try:
                await state.operation.lanes.transfers(work, state)
            except Exception:  # the other tasks still run
                _log.exception("housekeeping_failed", extra={"work": name})
        await asyncio.sleep(_EVERY_S)


async def follow_keys(state: State) -> None:
    """Every 0.1 s until cancelled, read keys changed by other processes, and end the streams of invalid ones."""
    threads = StorageThreads(1, _KEYS_WITHIN_S)
    while True:
        with suppress(StorageUnavailable, OSError):  # keys in memory stay valid
            await threads(state.keys.sync.refresh)
        state.streams.end_invalid()
        await asyncio.sleep(_KEYS_EVERY_S)


def _map_ids(state: State) -> set[str] | None:
    """The ids of all maps; None if one is damaged or was deleted meanwhile. Raises StorageUnavailable."""
    try:
        return {state.maps.sync.map_id(name) for name in state.maps.sync.names()}
    except (InvalidMap, UnknownMap):
        return None


def _learn(state: State) -> None:
    """Queue the night's learning jobs in the hour that the settings name, UTC, if they enable learning."""
    now = datetime.now(UTC)
    if state.settings.learn and now.hour == state.settings.learn_hour:
        learn_tonight(state, now)


def learn_tonight(state: State, now: datetime) -> None:
    """Queue a learning job for each map that has ``MIN_QUERIES`` queries of the last day and no unfinished learning
    job; once a night for all servers.
    """
    options = JobOptions(kind=JobKind.LEARN, priority=JobPriority.LOW)
    for name in state.maps.sync.names():
        try:
            map_id = state.maps.sync.map_id(name)
            if state.learning.store.newer_than(map_id, time.time() - _DAY_S) < MIN_QUERIES:
                continue
            night = hashlib.blake2b(f"{map_id} {now:%Y-%m-%d}".encode(), digest_size=16).hexdigest()
            if state.jobs.sync.learning(name) is None:
                state.jobs.sync.submit("", name, options, night)
        except RholocError as error:
            _log.warning("map_does_not_learn", extra={"map": name, "error": error.message})


_WORKS: dict[str, Callable[[State], None]] = {
    "uploads": lambda state: state.recordings.uploads.sweep(),
    "maps": lambda state: state.maps.sync.sweep(),
    "recordings": lambda state: state.recordings.sync.sweep(),
    "renderings": lambda state: state.renderings.sweep(),
    "mapped recordings": lambda state: state.jobs.sync.delete_mapped_recordings(
        state.settings.recording_retention_days * _DAY_S
    ),
    "queries": lambda state: state.learning.store.sweep(_map_ids(state)),
    "uploads of revoked keys": lambda state: state.quotas.sync.abandon_uploads(),
    "quotas": lambda state: state.quotas.sync.tidy(),
    "learning": _learn,
}
