"""Regular cleanup: removes what has expired."""

from __future__ import annotations

import asyncio

import structlog
from starlette.concurrency import run_in_threadpool

from rholoc.service.state import State

_EVERY_S = 600.0
_DAY_S = 24 * 3600.0
_log = structlog.get_logger("rholoc.service")


async def clean_up_regularly(state: State) -> None:
    """Remove expired uploads, pictures of maps that changed, recordings past their retention, until cancelled."""
    while True:
        try:
            await run_in_threadpool(_clean, state)
        except Exception:
            _log.exception("housekeeping_failed")
        await asyncio.sleep(_EVERY_S)


def _clean(state: State) -> None:
    state.uploads.sweep()
    state.library.sweep()
    state.recordings.sweep()
    state.renderings.sweep()
    state.jobs.delete_mapped_recordings(state.settings.recording_retention_days * _DAY_S)
