"""A mapping job as users see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from rholoc.mapping import DEFAULT_FEATURES
from rholoc.maps import DensityKind
from rholoc.progress import Stage
from rholoc.trajectory import PoseMethod


class JobKind(StrEnum):
    """What a job does."""

    BUILD = "build"  # makes a new map, replacing any of that name
    UPDATE = "update"  # learns it into the map of that name
    LEARN = "learn"  # lets the map of that name learn from the queries kept for it; there is no recording
    PLACE = "place"  # looks for links between the maps of a site; there is neither a recording nor a map

    @property
    def reads_recording(self) -> bool:
        """Whether it needs a recording."""
        return self in (JobKind.BUILD, JobKind.UPDATE)


class JobPriority(StrEnum):
    """How soon a job's turn comes."""

    HIGH = "high"  # before all others that were submitted within a day
    NORMAL = "normal"
    LOW = "low"  # after all others that are submitted within a day


@dataclass(frozen=True)
class JobOptions:
    """How a job builds or updates its map.

    Attributes:
        kind: what it does. An update keeps the map's own density and features.
        density: the form of the densities.
        features: the extractor's name.
        poses: where frame poses come from; None leaves it to :class:`rholoc.mapping.BuildOptions` or ``UpdateOptions``.
        camera: intrinsics as users write them (``fx,fy,cx,cy`` and so on), a stored camera's name, or None to take the
            recording's own.
        pictures: whether the map keeps a small picture of each view.
        frames: a choice of the recording's frames by number, ``start:stop[:step]``; None takes all.
        priority: how soon its turn comes.
        site: whose maps are placed, by a job that does that.
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

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> JobOptions:
        """Options as ``dataclasses.asdict`` made them, after a round trip through JSON."""
        return cls(
            density=DensityKind(stored["density"]),
            features=stored["features"],
            poses=PoseMethod(stored["poses"]) if stored["poses"] else None,
            camera=stored["camera"],
            kind=JobKind(stored["kind"]),
            pictures=stored["pictures"],
            frames=stored["frames"],
            priority=JobPriority(stored["priority"]),
            site=stored["site"],
        )


class JobState(StrEnum):
    """Where a job stands."""

    QUEUED = "queued"  # waiting for a worker
    RUNNING = "running"  # a worker has it
    PUBLISHED = "published"  # its map is in the library
    FAILED = "failed"  # it ended without a map; the error says why and the recording is kept
    CANCELLED = "cancelled"  # ended on request; the recording is kept

    @property
    def ended(self) -> bool:
        """Whether the job will no longer change by itself."""
        return self in (JobState.PUBLISHED, JobState.FAILED, JobState.CANCELLED)


class Obstacle(StrEnum):
    """Why no worker can take a queued job."""

    NO_WORKER = "no_worker"  # none is alive
    WORKER_FAILS = "worker_fails"  # none is alive: whenever one is started, it dies
    MEMORY = "memory"  # none that is alive has as much memory as it needs


@dataclass(frozen=True)
class Job:
    """One mapping job.

    Attributes:
        id: unique, 32 hex digits.
        recording: the recording's id; empty where the job needs none.
        map_name: the map that it will publish; empty where it places a site's maps.
        state: where it stands.
        stage: the stage it is in or ended in.
        progress: 0..1 over all stages.
        message: one line for people.
        log: the last lines of its log.
        warnings: why its published map is not to be trusted, or why maps of its site are not placed.
        error_code, error_message, error_hint: set when it failed.
        created, started, ended: seconds since the epoch, or None.
        attempts: how many workers have taken it up.
        priority: how soon its turn comes.
        memory_bytes: about how much memory it needs; None until its recording was read.
        worker: the id of the worker that has it; None where none has.
        obstacle: why no worker can take it; None where one can, or has, or need not.
        kind: what it does.
        site: whose maps it places; None where it makes a map.
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
        """Whether the map that it published is to be trusted; None before that, and where it makes none."""
        has_map = self.state is JobState.PUBLISHED and self.kind is not JobKind.PLACE
        return not self.warnings if has_map else None
