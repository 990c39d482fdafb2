"""Folders and limits of a worker."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rholoc.jobs.job import Capacity
from rholoc.processes.limits import Limits
from rholoc.recordings import MAX_FRAME_PIXELS


@dataclass(frozen=True)
class BuildLimits(Limits):
    """Limits of one build.

    Attributes:
        frame_pixels: maximum pixels of a video frame.
    """

    frame_pixels: int = MAX_FRAME_PIXELS


@dataclass(frozen=True)
class WorkerSetup:
    """Folders and limits of a worker.

    Attributes:
        data_dir, maps_dir: folders of jobs and of maps.
        database_url: ``postgresql://…``, or None for the SQLite file.
        storage_url: URL of the storage shared with other machines, or None for the folders.
        capacity: of the worker.
        limits: of one job.
    """

    data_dir: Path
    maps_dir: Path
    database_url: str | None = None
    storage_url: str | None = None
    capacity: Capacity = field(default_factory=Capacity)
    limits: BuildLimits = field(default_factory=BuildLimits)

    def to_line(self) -> bytes:
        """One line of JSON, for another process."""
        return json.dumps(asdict(self), default=str).encode() + b"\n"

    @classmethod
    def from_line(cls, line: bytes) -> WorkerSetup:
        """The setup that :meth:`to_line` made this line from."""
        values = json.loads(line)
        values["data_dir"], values["maps_dir"] = Path(values["data_dir"]), Path(values["maps_dir"])
        values["capacity"], values["limits"] = Capacity(**values["capacity"]), BuildLimits(**values["limits"])
        return cls(**values)
