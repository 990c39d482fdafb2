"""Regular work beside answering: removes what has expired, and lets maps learn at night."""

from __future__ import annotations

import asyncio
import hashlib
import time
from datetime import UTC, datetime

import structlog
from starlette.concurrency import run_in_threadpool

from rholoc.errors import InvalidMap, RholocError, UnknownMap
from rholoc.jobs import JobKind, JobOptions, JobPriority
from rholoc.mapping import FEWEST_QUERIES
from rholoc.service.state import State

_EVERY_S = 600.0
_DAY_S = 24 * 3600.0
_log = structlog.get_logger("rholoc.service")


async def clean_up_regularly(state: State) -> None:
    """Remove expired uploads and queries, pictures of maps that changed, recordings past their retention, until
    cancelled; at night let maps learn from their users."""
    while True:
        for work in (_clean, _learn):
            try:
                await run_in_threadpool(work, state)
            except Exception:
                _log.exception("housekeeping_failed")
        await asyncio.sleep(_EVERY_S)


def _clean(state: State) -> None:
    state.uploads.sweep()
    state.library.sweep()
    state.recordings.sweep()
    state.renderings.sweep()
    state.jobs.delete_mapped_recordings(state.settings.recording_retention_days * _DAY_S)
    state.queries.sweep(_map_ids(state))
    state.quotas.tidy()


def _map_ids(state: State) -> set[str] | None:
    """The ids of all maps; None where one cannot be read."""
    try:
        return {state.library.map_id(name) for name in state.library.names()}
    except (InvalidMap, UnknownMap):
        return None


def _learn(state: State) -> None:
    now = datetime.now(UTC)
    if state.settings.learn and now.hour == state.settings.learn_hour:
        learn_tonight(state, now)


def learn_tonight(state: State, now: datetime) -> None:
    """Queue a job for each map that was asked often enough since the night before; once a night, on one server of all
    that share a database."""
    options = JobOptions(kind=JobKind.LEARN, priority=JobPriority.LOW)
    for name in state.library.names():
        try:
            map_id = state.library.map_id(name)
            if state.queries.newer_than(map_id, time.time() - _DAY_S) < FEWEST_QUERIES:
                continue
            night = hashlib.blake2b(f"{map_id} {now:%Y-%m-%d}".encode(), digest_size=16).hexdigest()
            if state.jobs.learning(name) is None:
                state.jobs.submit("", name, options, night)
        except RholocError as error:
            _log.warning("map_does_not_learn", map=name, error=error.message)
