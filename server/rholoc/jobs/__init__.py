"""Durable mapping jobs: stored recordings, the queue, and the workers that turn recordings into maps."""

from rholoc.jobs.build_process import BuildLimits
from rholoc.jobs.capacity import Capacity, MoreMemoryNeeded
from rholoc.jobs.data_import import ImportedData, import_data
from rholoc.jobs.embedded import EmbeddedWorker
from rholoc.jobs.job import Job, JobKind, JobOptions, JobPriority, JobState, Obstacle
from rholoc.jobs.pipeline import MappingPipeline, MappingTask
from rholoc.jobs.query_store import KeptLimits, KeptQueries, QueryStore
from rholoc.jobs.queue import JobQueue
from rholoc.jobs.recording_notes import (
    WAYPOINTS_FILE,
    RecordedWaypoint,
    RecordingNotes,
    corrected_waypoints,
    read_notes,
    read_thumbnail,
    waypoints_file,
)
from rholoc.jobs.recording_store import PendingRecording, RecordingEntry, RecordingStore
from rholoc.jobs.stores import Stores
from rholoc.jobs.timing import Timing
from rholoc.jobs.upload_store import Upload, UploadStore
from rholoc.jobs.worker import run_worker

__all__ = [
    "WAYPOINTS_FILE",
    "BuildLimits",
    "Capacity",
    "EmbeddedWorker",
    "ImportedData",
    "Job",
    "JobKind",
    "JobOptions",
    "JobPriority",
    "JobQueue",
    "JobState",
    "KeptLimits",
    "KeptQueries",
    "MappingPipeline",
    "MappingTask",
    "MoreMemoryNeeded",
    "Obstacle",
    "PendingRecording",
    "QueryStore",
    "RecordedWaypoint",
    "RecordingEntry",
    "RecordingNotes",
    "RecordingStore",
    "Stores",
    "Timing",
    "Upload",
    "UploadStore",
    "corrected_waypoints",
    "import_data",
    "read_notes",
    "read_thumbnail",
    "run_worker",
    "waypoints_file",
]
