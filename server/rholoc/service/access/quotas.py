"""What each API key may hold: maps, bytes and jobs. All servers that share a database count together."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, nullcontext, suppress
from dataclasses import dataclass

from rholoc.errors import UnknownMap, UnknownRecording
from rholoc.jobs import JobQueue, RecordingStore, UploadStore
from rholoc.maps import MapLibrary
from rholoc.service.access.keys import ApiKey, KeyStore
from rholoc.service.errors import QuotaExceeded
from rholoc.storage.holdings import Holding, Holdings, Kind


@dataclass(frozen=True)
class Usage:
    """What a key holds, with the keys that it handed on.

    Attributes:
        maps: how many, with those that its jobs will publish.
        stored_bytes: of these maps and of recordings; an unfinished upload counts as what it will be.
        jobs: how many are queued or running, or will be when an upload is complete.
    """

    maps: int
    stored_bytes: int
    jobs: int


@dataclass(frozen=True)
class HeldUpload:
    """An unfinished upload.

    Attributes:
        id: of the upload.
        map: the name of the map that it is for.
        size_bytes: its length, once it is complete; 0 where no key is needed.
        key: the name of the key that began it; empty where none is needed.
        holder: the name of the first of the keys that handed ``key`` on; empty if none did.
    """

    id: str
    map: str
    size_bytes: int
    key: str
    holder: str


@dataclass(frozen=True)
class _Present:
    """What there is: maps, recordings or uploads, and jobs that have not ended or are to come, with their maps."""

    maps: frozenset[str]
    recordings: frozenset[str]
    jobs: dict[str, str]

    def has(self, holding: Holding) -> bool:
        """Whether what is held is there."""
        if holding.kind is Kind.MAP:
            return holding.name in self.maps or holding.name in self.jobs.values()
        return holding.name in (self.jobs if holding.kind is Kind.JOB else self.recordings)


class Quotas:
    """Counts what keys hold, and refuses what would be more than they may.

    A request asks :meth:`check` before it stores something, within :meth:`counting` until it has noted it: of requests
    to one server none is let in for what another was let in for. Two servers may both let in the last.
    """

    def __init__(
        self,
        holdings: Holdings,
        keys: KeyStore,
        library: MapLibrary,
        recordings: RecordingStore,
        uploads: UploadStore,
        jobs: JobQueue,
    ) -> None:
        self._holdings = holdings
        self._keys = keys
        self._library = library
        self._recordings = recordings
        self._uploads = uploads
        self._jobs = jobs
        self._locks: dict[str, asyncio.Lock] = {}

    @asynccontextmanager
    async def counting(self, key: ApiKey | None) -> AsyncIterator[None]:
        """While nothing else is counted to the key, or to keys that are counted with it."""
        first = "" if key is None else self._keys.chain(key)[-1].name
        async with self._locks.setdefault(first, asyncio.Lock()) if first else nullcontext():
            yield

    def check_upload(self, key: ApiKey | None, max_of_client: int) -> None:
        """Refuse a resumable upload if a key with those above and below it has too many unfinished ones.

        Raises:
            QuotaExceeded: it has.
        """
        if key is None:
            return
        first = self._keys.chain(key)[-1].name
        mine = sum(first in (one.key, one.holder) for one in self.uploads())
        if mine >= max_of_client:
            raise QuotaExceeded(
                f"The key {first} has {mine} unfinished uploads, the most allowed.",
                "Finish or abandon (DELETE) one.",
            )

    def uploads(self) -> list[HeldUpload]:
        """The unfinished uploads, and whose they are where keys are needed."""
        held = {one.name: one for one in self._holdings.all() if one.kind is Kind.RECORDING}
        nobody = Holding(Kind.RECORDING, "", "")
        found = []
        for upload_id, map_name in self._uploads.unfinished().items():
            holding = held.get(upload_id, nobody)
            found.append(HeldUpload(upload_id, map_name, holding.size_bytes, holding.key, holding.holder))
        return found

    def abandon_uploads(self) -> None:
        """Delete the unfinished uploads of keys that were revoked."""
        existing = self._keys.keys()
        names = {key.name for key in existing}
        for one in self.uploads():
            if one.key and one.key not in names:
                with suppress(UnknownRecording):  # it was finished meanwhile
                    self._uploads.delete(one.id)

    def check(
        self, key: ApiKey | None, stores: str | None = None, size_bytes: int = 0, job_for: str | None = None
    ) -> None:
        """Refuse what would be more than a key, or the one that handed it on, may hold.

        Args:
            key: the request's; None where no key is needed: everything is allowed.
            stores: the map that is stored, in place of what the key holds under that name.
            size_bytes: what is stored.
            job_for: the map that a job is queued for; empty where it makes none.

        Raises:
            QuotaExceeded: it would.
        """
        limited = _limited([] if key is None else self._keys.chain(key))
        if not limited:
            return
        present = self._present()
        made = set() if stores is None else {stores}
        if job_for and job_for not in present.maps:
            made.add(job_for)
        for one in limited:
            held = [holding for holding in self._holdings.of(self._keys.family(one.name)) if present.has(holding)]
            used, maps = self._usage(held, present), _maps(held, present)
            freed = self._map_bytes(stores) if stores in maps else 0
            if made:
                _check("maps", len(maps | made), one.limits.maps, used.maps, one.name)
            if size_bytes:
                stored = used.stored_bytes - freed + size_bytes
                _check("stored bytes", stored, one.limits.stored_bytes, used.stored_bytes, one.name)
            if job_for is not None:
                _check("unfinished jobs", used.jobs + 1, one.limits.jobs, used.jobs, one.name)

    def usage(self, name: str) -> Usage:
        """What the key of a name holds."""
        present = self._present()
        return self._usage(
            [one for one in self._holdings.of(self._keys.family(name) or [name]) if present.has(one)], present
        )

    def hold(self, key: ApiKey | None, kind: Kind, name: str, size_bytes: int = 0) -> None:
        """Note that a key holds something."""
        if key is not None:
            first = self._keys.chain(key)[-1].name
            self._holdings.hold(Holding(kind, name, key.name, first if first != key.name else "", size_bytes))

    def hold_job(self, key: ApiKey | None, job_id: str, map_name: str) -> None:
        """Note that a key holds a job, and the map that it will publish if there is none of that name."""
        self.hold(key, Kind.JOB, job_id)
        if map_name and map_name not in self._library.names():
            self.hold(key, Kind.MAP, map_name)

    def rename_map(self, name: str, new_name: str) -> None:
        """Let the holder of a map hold it under its new name."""
        self._holdings.rename(Kind.MAP, name, new_name)

    def tidy(self) -> None:
        """Forget who held what is not there any more."""
        held = self._holdings.all()  # before looking at what there is, which is noted before it is held
        if held:
            present = self._present()
            self._holdings.drop([one for one in held if not present.has(one)])

    def _present(self) -> _Present:
        """Each before what it becomes: an upload is a recording with a job, a job a map."""
        uploads = self._uploads.unfinished()
        recordings = frozenset(entry.id for entry in self._recordings.list())
        jobs = uploads | self._jobs.unfinished()
        return _Present(frozenset(self._library.names()), recordings | uploads.keys(), jobs)

    def _usage(self, held: Sequence[Holding], present: _Present) -> Usage:
        stored = sum(one.size_bytes for one in held if one.kind is Kind.RECORDING)
        stored += sum(self._map_bytes(one.name) for one in held if one.kind is Kind.MAP)
        return Usage(len(_maps(held, present)), stored, sum(one.kind is Kind.JOB for one in held))

    def _map_bytes(self, name: str | None) -> int:
        try:
            return 0 if name is None else self._library.stat(name).size_bytes
        except UnknownMap:  # a job is to publish it
            return 0


def _limited(keys: Sequence[ApiKey]) -> list[ApiKey]:
    return [key for key in keys if key.limits.quotas]


def _maps(held: Sequence[Holding], present: _Present) -> set[str]:
    """The maps that are held, with those that the jobs that are held will publish."""
    return {
        present.jobs[one.name] if one.kind is Kind.JOB else one.name for one in held if one.kind is not Kind.RECORDING
    }


def _check(what: str, wanted: int, most: int | None, used: int, name: str) -> None:
    if most is not None and wanted > most:
        raise QuotaExceeded(
            f"The key {name} may have {most} {what}, and has {used}.",
            "Delete some, wait until jobs have ended, or ask whoever runs the server for more.",
        )
