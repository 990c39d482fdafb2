"""A mapping job as users see it, its memory, and a worker's capacity."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from rholoc.features import DEFAULT_FEATURES
from rholoc.maps import DensityKind
from rholoc.progress import Stage
from rholoc.recordings import Recording
from rholoc.trajectory import PoseMethod

# Peak memory of all processes of a mapping job: 0.91 GB for 5 s of a drone, 0.98 GB for 24 s with a phone, and for
# simulated walks 1.12 GB for 30 s, 1.43 GB for 2 minutes, 2.3 GB for 5 and 3.7 GB for 10. None held more than is
# expected here.
_BASE_BYTES = 1e9
_BYTES_PER_SECOND = 5e6
SECONDS_PER_PICTURE = 1.0  # of a walk that take as much memory as a picture without a time
_BYTES_PER_PIXEL = 60.0  # some twenty images at a time, of three bytes a pixel
_MARGIN = 1.5  # times the memory that a killed job held


class JobKind(StrEnum):
    """Kind of a job."""

    BUILD = "build"  # build a new map, replacing any of that name
    UPDATE = "update"  # learn the recording into the map of that name
    LEARN = "learn"  # let the map of that name learn from its kept queries; without a recording
    PLACE = "place"  # look for links between the maps of a site; without a recording or a map name

    @property
    def reads_recording(self) -> bool:
        """Whether jobs of this kind need a recording."""
        return self in (JobKind.BUILD, JobKind.UPDATE)


class JobPriority(StrEnum):
    """Priority of a job."""

    HIGH = "high"  # before all others that were submitted within a day
    NORMAL = "normal"
    LOW = "low"  # after all others that are submitted within a day


@dataclass(frozen=True)
class JobOptions:
    """Options of a job for building or updating its map.

    Attributes:
        kind: of the job. An update keeps the map's own density and features.
        density: form of the densities.
        features: name of the extractor.
        poses: method for frame poses; None for that of :class:`rholoc.mapping.BuildOptions` or ``UpdateOptions``.
        camera: intrinsics as text (``fx,fy,cx,cy`` and so on), a stored camera's name, or None for the recording's own.
        pictures: whether the map keeps a small picture of each view.
        frames: the recording's frames to use, ``start:stop[:step]``; None for all.
        priority: of the job.
        site: name of the site for a job that places maps.
    """

    density: DensityKind = DensityKind.RAY
    features: str = DEFAULT_FEATURES
    poses: PoseMethod | None = None
    camera: str | None = None
    kind: JobKind = JobKind.BUILD
    pictures: bool = False
    frames: str | None = None
    priority: JobPriority = JobPriority.NORMAL
    site: str | None = None


class JobState(StrEnum):
    """State of a job."""

    QUEUED = "queued"  # waiting for a worker
    RUNNING = "running"  # taken by a worker
    PUBLISHED = "published"  # its map is in the library
    FAILED = "failed"  # ended without a map; the error says why, and the recording is kept
    CANCELLED = "cancelled"  # ended on request; the recording is kept

    @property
    def ended(self) -> bool:
        """Whether the job will no longer change by itself."""
        return self in (JobState.PUBLISHED, JobState.FAILED, JobState.CANCELLED)


class Obstacle(StrEnum):
    """Why no worker can take a queued job."""

    NO_WORKER = "no_worker"  # none is alive
    WORKER_FAILS = "worker_fails"  # none is alive: they die when started
    MEMORY = "memory"  # no living worker has enough memory


@dataclass(frozen=True)
class Job:
    """One mapping job.

    Attributes:
        id: unique, 32 hex digits.
        recording: the recording's id; empty if the job needs none.
        map_name: name of the map to publish; empty if it places a site's maps.
        state: present state.
        stage: present or last stage.
        progress: 0..1 over all stages.
        message: one line for people.
        log: the last lines of its log.
        warnings: why its published map should not be trusted, or why maps of its site are not placed.
        error_code, error_message, error_hint: set if it failed.
        created, started, ended: seconds since the epoch, or None. ``started`` is when the present worker took the job.
        attempts: number of workers that have taken it.
        priority: of the job.
        memory_bytes: estimated memory; None until its recording was read.
        worker: id of the worker that has it, or None.
        obstacle: why no worker can take it; None unless it is queued and blocked.
        kind: of the job.
        site: name of the site whose maps it places, or None.
    """

    id: str
    recording: str
    map_name: str
    state: JobState
    stage: Stage
    progress: float
    message: str
    log: tuple[str, ...]
    warnings: tuple[str, ...]
    error_code: str | None
    error_message: str | None
    error_hint: str | None
    created: float
    started: float | None
    ended: float | None
    attempts: int
    priority: JobPriority = JobPriority.NORMAL
    memory_bytes: int | None = None
    worker: str | None = None
    obstacle: Obstacle | None = None
    kind: JobKind = JobKind.BUILD
    site: str | None = None

    @property
    def trusted(self) -> bool | None:
        """Whether its published map has no warnings; None if it has published none."""
        has_map = self.state is JobState.PUBLISHED and self.kind is not JobKind.PLACE
        return not self.warnings if has_map else None


@dataclass(frozen=True)
class Capacity:
    """Capacity of a worker.

    Attributes:
        jobs: maximum number at a time.
        memory_bytes: maximum memory of all their processes together.
    """

    jobs: int = 1
    memory_bytes: float = math.inf


@dataclass(frozen=True)
class MoreMemoryNeeded:
    """A job needs more memory than its worker grants it.

    Attributes:
        memory_bytes: required memory.
    """

    memory_bytes: int

    @classmethod
    def after(cls, held_bytes: float, granted_bytes: float, most_bytes: float) -> MoreMemoryNeeded | None:
        """Estimated need of a job killed for its memory: 1.5 × ``held_bytes``, more than ``granted_bytes``, at most
        ``most_bytes``.

        None if the largest worker has no more than was granted.

        Args:
            held_bytes: measured memory before it was killed.
            granted_bytes: memory that it was granted.
            most_bytes: memory of the largest worker.
        """
        if not most_bytes > granted_bytes:
            return None
        return cls(int(min(max(_MARGIN * held_bytes, granted_bytes + 1), most_bytes)))


def memory_for(recording: Recording) -> int:
    """Estimated memory for mapping a recording [bytes]; frames without times count as a second each."""
    times, (width, height) = recording.frames.times, recording.frames.size
    length_s = float(times[-1] - times[0]) if recording.frames.timed else len(times) * SECONDS_PER_PICTURE
    return memory_for_walk(length_s, width * height)


def memory_for_walk(length_s: float, frame_pixels: int) -> int:
    """Estimated memory for mapping a walk [bytes]: 1 GB, 5 MB per second of ``length_s``, 60 bytes per pixel."""
    return int(_BASE_BYTES + _BYTES_PER_SECOND * length_s + _BYTES_PER_PIXEL * frame_pixels)
