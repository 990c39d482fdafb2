"""Quotas of API keys for maps, bytes and jobs, counted over all servers that share a database."""

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, nullcontext, suppress
from dataclasses import dataclass

from rholoc.errors import UnknownMap, UnknownRecording
from rholoc.jobs import JobQueue, UploadStore
from rholoc.library.maps import MapLibrary
from rholoc.library.recordings import RecordingStore
from rholoc.service.access.keys import ApiKey, KeyStore
from rholoc.service.errors import QuotaExceeded
from rholoc.storage.holdings_table import Holding, Holdings, Kind


@dataclass(frozen=True)
class Usage:
    """Usage of a key together with the keys that it handed on.

    Attributes:
        maps: number, including maps that its jobs will publish.
        stored_bytes: of maps and recordings; an unfinished upload counts with its full length.
        jobs: number of queued and running jobs, and of unfinished uploads with a job.
    """

    maps: int
    stored_bytes: int
    jobs: int


@dataclass(frozen=True)
class HeldUpload:
    """An unfinished upload.

    Attributes:
        id: of the upload.
        map: name of the map to make.
        size_bytes: full length; 0 if no key is needed.
        key: name of the key that began it; empty if none is needed.
        holder: name of the root of the key's chain; empty if the key was not handed on.
    """

    id: str
    map: str
    size_bytes: int
    key: str
    holder: str


@dataclass(frozen=True)
class _Present:
    """Existing maps, recordings and uploads by name or id, and the map name of each unended job or upload by its id."""

    maps: frozenset[str]
    recordings: frozenset[str]
    jobs: dict[str, str]

    def has(self, holding: Holding) -> bool:
        """Whether the held thing exists; for a map, also whether an unended job will make it."""
        if holding.kind is Kind.MAP:
            return holding.name in self.maps or holding.name in self.jobs.values()
        return holding.name in (self.jobs if holding.kind is Kind.JOB else self.recordings)


class Quotas:
    """Counts the holdings of keys and enforces their limits.

    A request calls :meth:`check` before it stores something and :meth:`hold` after, both within :meth:`counting`,
    so that concurrent requests to one server cannot exceed a limit. Requests to two servers may.
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
        """Lock, within the block, the counts of the key's root and of all keys below that; nothing without a key."""
        first = "" if key is None else self._keys.chain(key)[-1].name
        async with self._locks.setdefault(first, asyncio.Lock()) if first else nullcontext():
            yield

    def check_upload(self, key: ApiKey | None, max_of_client: int) -> None:
        """Raise QuotaExceeded if the key's root and all keys below it have ``max_of_client`` unfinished uploads. A key
        of None passes.
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
        """The unfinished uploads, with or without a key."""
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
        """Check the limits of a key and of its parents for maps, bytes and jobs before something is stored; records
        nothing.

        Args:
            key: of the request; None if no key is needed, which allows everything.
            stores: name of the map to store, replacing the key's map of that name; None if none is stored.
            size_bytes: size to store.
            job_for: name of the map that a job to queue will make; empty if it makes none; None without a job.

        Raises:
            QuotaExceeded: a limit would be exceeded.
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
        """Usage of the key called ``name`` with all keys below it; of a revoked key, usage by what it still holds."""
        present = self._present()
        return self._usage(
            [one for one in self._holdings.of(self._keys.family(name) or [name]) if present.has(one)], present
        )

    def hold(self, key: ApiKey | None, kind: Kind, name: str, size_bytes: int = 0) -> None:
        """Record that a key, unless it is None, holds a thing of a kind and a size [bytes]."""
        if key is not None:
            first = self._keys.chain(key)[-1].name
            self._holdings.hold(Holding(kind, name, key.name, first if first != key.name else "", size_bytes))

    def hold_job(self, key: ApiKey | None, job_id: str, map_name: str) -> None:
        """Record that a key, unless it is None, holds a job, and the map that it will make if no map has that name."""
        self.hold(key, Kind.JOB, job_id)
        if map_name and map_name not in self._library.names():
            self.hold(key, Kind.MAP, map_name)

    def rename_map(self, name: str, new_name: str) -> None:
        """Record that a held map has another name."""
        self._holdings.rename(Kind.MAP, name, new_name)

    def tidy(self) -> None:
        """Remove holdings of maps, recordings, jobs and uploads that no longer exist."""
        held = self._holdings.all()  # before listing what exists, because things exist before they are held
        if held:
            present = self._present()
            self._holdings.drop([one for one in held if not present.has(one)])

    def _present(self) -> _Present:
        """List uploads, recordings, jobs, then maps: each kind before the one it turns into, so that none is missed. An
        upload counts as a recording and as a job.
        """
        uploads = self._uploads.unfinished()
        recordings = frozenset(entry.id for entry in self._recordings.list())
        jobs = uploads | self._jobs.unfinished()
        return _Present(frozenset(self._library.names()), recordings | uploads.keys(), jobs)

    def _usage(self, held: Sequence[Holding], present: _Present) -> Usage:
        """Maps, bytes of maps and recordings, and unfinished jobs among holdings."""
        stored = sum(one.size_bytes for one in held if one.kind is Kind.RECORDING)
        stored += sum(self._map_bytes(one.name) for one in held if one.kind is Kind.MAP)
        return Usage(len(_maps(held, present)), stored, sum(one.kind is Kind.JOB for one in held))

    def _map_bytes(self, name: str | None) -> int:
        """Size of a map's file; 0 for None, or if it is not published yet."""
        try:
            return 0 if name is None else self._library.stat(name).size_bytes
        except UnknownMap:  # not published yet
            return 0


def _limited(keys: Sequence[ApiKey]) -> list[ApiKey]:
    """The keys that have any quota."""
    return [key for key in keys if key.limits.quotas]


def _maps(held: Sequence[Holding], present: _Present) -> set[str]:
    """Held maps, and maps that held jobs will publish."""
    return {
        present.jobs[one.name] if one.kind is Kind.JOB else one.name for one in held if one.kind is not Kind.RECORDING
    }


def _check(what: str, wanted: int, most: int | None, used: int, name: str) -> None:
    """Raise QuotaExceeded, naming ``what`` and ``used``, if ``wanted`` exceeds ``most`` (None: no limit)."""
    if most is not None and wanted > most:
        raise QuotaExceeded(
            f"The key {name} may have {most} {what}, and has {used}.",
            "Delete some, wait until jobs have ended, or ask whoever runs the server for more.",
        )
