"""Check a server's environment. Each finding says what to do."""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib import metadata, resources
from pathlib import Path
from uuid import uuid4

from packaging.requirements import InvalidRequirement, Requirement

from rholoc.errors import InvalidMap, InvalidRecording, RholocError
from rholoc.jobs import JobQueue
from rholoc.library.sites import SiteLibrary
from rholoc.library.stores import SITES, Stores
from rholoc.pictures.style import missing_fonts
from rholoc.processes.limits import machine_memory_bytes
from rholoc.recordings.frames.video import read_video
from rholoc.service.access.keys import KeyStore
from rholoc.service.settings import KeyPolicy, Settings, keys_needed

_MIN_FREE_BYTES, _LITTLE_FREE_BYTES = 2**28, 2**32
_CLOCK_TOLERANCE_S = 5.0
_EARLIEST_S = 1_767_225_600.0  # 2026-01-01, before which no correct clock can be
_GREY, _GREY_TOLERANCE = 128, 12  # of the clips' frames
_CLIPS = {"H.264": "h264.mp4", "HEVC": "hevc.mp4", "VP8": "vp8.webm", "VP9": "vp9.webm"}
_GIB = 2**30


class Level(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    WARNING = "warning"  # works, but perhaps not as expected
    ERROR = "error"  # something does not work


@dataclass(frozen=True)
class Finding:
    """Result of a check.

    Attributes:
        check: subject of the check, such as ``storage``.
        level: severity.
        message: one line: what was found.
        hint: one line: what to do; empty if nothing.
    """

    check: str
    level: Level
    message: str
    hint: str = ""


def examine(settings: Settings) -> list[Finding]:
    """Run all checks and return their findings in order, good ones too; a check that raises becomes a finding."""
    found: list[Finding] = []
    for check, look in _CHECKS.items():
        try:
            found += [Finding(check, *finding) for finding in look(settings)]
        except Exception as error:
            found.append(Finding(check, Level.ERROR, f"It cannot be checked: {error!r}"[:300], "Mend that first."))
    return found


_Found = Iterator[tuple[Level, str] | tuple[Level, str, str]]


def _storage(settings: Settings) -> _Found:
    """Yield for each folder whether it can be written to and has space: error below 256 MiB, warning below 4 GiB."""
    folders = {settings.data_dir: "RHOLOC_DATA_DIR"}
    if settings.shared_storage is None:
        folders = {settings.maps_dir: "RHOLOC_MAPS_DIR", **folders}
    for folder, variable in folders.items():
        if not folder.exists() and _can_be_created(folder):
            yield Level.OK, f"There is no {folder} yet; the first start creates it."
            continue
        if not folder.is_dir():
            yield Level.ERROR, f"There is no folder {folder}.", f"Create it, or set {variable}."
            continue
        probe = folder / f".{uuid4().hex}.doctor"
        try:
            probe.write_bytes(b"probe")
            probe.unlink()
        except OSError as error:
            yield Level.ERROR, f"{folder} cannot be written to: {error.strerror}.", "Check its owner and permissions."
            continue
        free = shutil.disk_usage(folder).free
        space = f"{folder} can be written to; {free / _GIB:.1f} GiB are free"
        if free < _MIN_FREE_BYTES:
            yield Level.ERROR, f"{space}, which is too little for a map.", "Free some space."
        elif free < _LITTLE_FREE_BYTES:
            yield Level.WARNING, f"{space}, which a few recordings fill.", "Free some space."
        else:
            yield Level.OK, f"{space}."


def _can_be_created(folder: Path) -> bool:
    """Whether the nearest of the folder's parents that exists is a folder that can be written to."""
    above = next(parent for parent in folder.absolute().parents if parent.exists())
    return above.is_dir() and os.access(above, os.W_OK | os.X_OK)


def _maps(settings: Settings) -> _Found:
    """Yield which map files cannot be read, whether the shared storage answers, and which sites name missing maps."""
    stores = settings.stores()
    try:
        if stores.are_shared:
            stores.open()
        yield from _maps_in(stores)
    except RholocError as error:
        yield Level.ERROR, error.message, error.hint
    finally:
        stores.close()


def _maps_in(stores: Stores) -> _Found:
    """Yield which maps and sites cannot be read, and which sites name missing maps; of shared maps one is read."""
    names, broken = stores.library.names(), 0
    for name in names[:1] if stores.are_shared else names:
        try:
            stores.library.outline(name)
        except InvalidMap as error:
            broken += 1
            hint = "Restore it from a backup, or delete it."
            yield Level.ERROR, f"The map {name} cannot be read: {error.message}", hint
    if not broken:
        yield Level.OK, f"{len(names)} maps" + (" in shared storage, which answers." if stores.are_shared else ".")
    sites = SiteLibrary(stores.documents(SITES))
    for name in sites.names():
        try:
            gone = [one.map for one in sites.get(name).maps if one.map not in set(names)]
        except RholocError as error:
            yield Level.ERROR, error.message, error.hint
            continue
        if gone:
            shown = ", ".join(gone[:5])
            yield Level.WARNING, f"The site {name} names maps that there are not: {shown}.", "Put it without."


def _jobs(settings: Settings) -> _Found:
    """Yield whether the database of jobs answers, with its counts, and a warning if no worker runs."""
    if not settings.data_dir.is_dir():
        yield Level.OK, "There is no database of jobs yet; the first start creates it."
        return
    queue = JobQueue(settings.stores().recordings)
    try:
        queue.check()
        begun = time.perf_counter()
        counts = queue.counts()
        took_ms = 1000 * (time.perf_counter() - begun)
        waiting = ", ".join(f"{count} {state}" for state, count in counts.items() if count) or "no jobs"
        yield Level.OK, f"The database of jobs answers in {took_ms:.0f} ms: {waiting}."
        if not settings.worker and not queue.has_worker():
            yield Level.WARNING, "No worker runs: recordings wait.", "Start rholoc worker, or set RHOLOC_WORKER=1."
    except RholocError as error:
        yield Level.ERROR, error.message, error.hint
    finally:
        queue.close()


def _clock(settings: Settings) -> _Found:
    """Yield whether the clock is past 2026-01-01, and within 5 s of the storage's."""
    now = time.time()
    if now < _EARLIEST_S:
        yield Level.ERROR, f"The clock says {time.strftime('%Y-%m-%d', time.gmtime(now))}.", "Set it, by NTP at best."
        return
    if settings.data_dir.is_dir() and os.access(settings.data_dir, os.W_OK):
        probe = settings.data_dir / f".{uuid4().hex}.doctor"
        probe.write_bytes(b"")
        apart_s = probe.stat().st_mtime - time.time()
        probe.unlink()
        if abs(apart_s) > _CLOCK_TOLERANCE_S:
            yield Level.WARNING, f"The storage's clock is {apart_s:+.0f} s off this machine's.", "Set both by NTP."
            return
    yield Level.OK, f"It is {time.strftime('%Y-%m-%d %H:%M:%S', time.gmtime(now))} UTC."


def _fonts(_: Settings) -> _Found:
    """Yield which fonts for pictures are missing."""
    missing = missing_fonts()
    if missing:
        yield Level.WARNING, f"Fonts are missing: {', '.join(missing)}.", "Install matplotlib again, which brings them."
    else:
        yield Level.OK, "Pictures have their fonts."


def _videos(_: Settings) -> _Found:
    """Yield which kinds of video that phones record cannot be decoded, by a clip of each."""
    unread = []
    for codec, name in _CLIPS.items():
        with resources.as_file(resources.files("rholoc.service.operate") / "clips" / name) as path:
            if not _is_decoded(path):
                unread.append(codec)
    if unread:
        hint = "Install opencv-python-headless from its wheel, which has them all."
        yield Level.ERROR, f"Videos of these kinds cannot be decoded: {', '.join(unread)}.", hint
    else:
        yield Level.OK, f"{', '.join(_CLIPS)} are decoded."


def _is_decoded(path: Path) -> bool:
    """Whether the first two frames of a clip are decoded, with its mean grey value (128 ± 12)."""
    try:
        frames = list(read_video(path).images([0, 1]))
    except InvalidRecording:
        return False
    return all(abs(float(frame.mean()) - _GREY) < _GREY_TOLERANCE for frame in frames)


def _libraries(_: Settings) -> _Found:
    """Yield which installed libraries are missing or of other versions than rholoc's metadata requires."""
    count, wrong = 0, 0
    for text in metadata.requires("rholoc") or []:
        try:
            wanted = Requirement(text)
        except InvalidRequirement:
            continue
        if wanted.marker is not None and not wanted.marker.evaluate({"extra": "server"}):
            continue
        count += 1
        try:
            version = metadata.version(wanted.name)
        except metadata.PackageNotFoundError:
            wrong += 1
            yield Level.ERROR, f"{wanted.name} is not installed.", f"pip install '{wanted}'"
            continue
        if not wanted.specifier.contains(version, prereleases=True):
            wrong += 1
            yield Level.WARNING, f"{wanted.name} is {version}; {wanted.specifier} is needed.", f"pip install '{wanted}'"
    if not wrong:
        yield Level.OK, f"{count} libraries are of versions that are supported."


def _settings(settings: Settings) -> _Found:
    """Yield a warning for each setting that contradicts another or the machine; OK if there is none."""
    memory_bytes = machine_memory_bytes()
    open_to_all = not keys_needed(settings.keys, settings.host)
    local = settings.keys is KeyPolicy.AUTO
    doubts = [
        (
            open_to_all and not local,
            f"Anybody who reaches {settings.host} may do everything: RHOLOC_KEYS is {settings.keys}.",
            "Set RHOLOC_KEYS=auto, or have something in front of the server ask who is there.",
        ),
        (
            not open_to_all and settings.shared_storage is None and not KeyStore(settings.data_dir).keys(),
            "Requests need a key, and there is none.",
            "Make one: rholoc key create NAME --scope admin.",
        ),
        (
            settings.map_cache_bytes < settings.max_map_bytes,
            "A map may be larger than what RHOLOC_MAP_CACHE_BYTES keeps in memory.",
            "Raise it, or lower RHOLOC_MAX_MAP_BYTES.",
        ),
        (
            settings.max_map_bytes > settings.max_upload_bytes,
            "Maps may be larger than an upload may be.",
            "Raise RHOLOC_MAX_UPLOAD_BYTES to RHOLOC_MAX_MAP_BYTES.",
        ),
        (
            settings.map_cache_bytes > memory_bytes / 2,
            "Maps may take more than half of the memory.",
            "Lower RHOLOC_MAP_CACHE_BYTES: frames and jobs need some.",
        ),
        (
            settings.worker and settings.job_memory_gib * _GIB > memory_bytes,
            "A mapping job may take more memory than there is.",
            "Lower RHOLOC_JOB_MEMORY_GIB.",
        ),
        (
            settings.worker and settings.worker_memory_gib * _GIB > memory_bytes,
            "The worker takes on jobs that need more memory than there is.",
            "Lower RHOLOC_WORKER_MEMORY_GIB.",
        ),
        (
            settings.concurrency > 2 * (os.cpu_count() or 1),
            f"{settings.concurrency} frames at a time are more than {os.cpu_count()} cores do well.",
            "Lower RHOLOC_CONCURRENCY to the number of cores.",
        ),
        (
            settings.max_request_bytes > settings.max_upload_bytes,
            "A frame may be larger than an upload may be.",
            "Lower RHOLOC_MAX_REQUEST_BYTES.",
        ),
        (
            settings.maps_dir.resolve() == settings.data_dir.resolve(),
            "Maps and data are in one folder.",
            "Give RHOLOC_MAPS_DIR and RHOLOC_DATA_DIR folders of their own.",
        ),
    ]
    doubted = [(message, hint) for is_so, message, hint in doubts if is_so]
    for message, hint in doubted:
        yield Level.WARNING, message, hint
    if not doubted:
        yield Level.OK, "The settings agree with each other."


_CHECKS: dict[str, Callable[[Settings], _Found]] = {
    "storage": _storage,
    "maps": _maps,
    "jobs": _jobs,
    "clock": _clock,
    "fonts": _fonts,
    "videos": _videos,
    "libraries": _libraries,
    "settings": _settings,
}
