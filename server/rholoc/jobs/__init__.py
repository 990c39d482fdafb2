"""Durable mapping jobs: recordings on disk, the queue, and the workers that turn recordings into maps."""

from rholoc.jobs.build_process import BuildLimits
from rholoc.jobs.embedded import EmbeddedWorker
from rholoc.jobs.job import Job, JobKind, JobOptions, JobState
from rholoc.jobs.pipeline import MappingPipeline, MappingTask, Pipeline
from rholoc.jobs.queue import JobQueue
from rholoc.jobs.recording_notes import (
    RecordedWaypoint,
    RecordingNotes,
    correct_waypoints,
    corrected_waypoints,
    has_thumbnail,
    read_notes,
    read_thumbnail,
)
from rholoc.jobs.recording_store import PendingRecording, RecordingEntry, RecordingStore
from rholoc.jobs.upload_store import Upload, UploadStore
from rholoc.jobs.worker import Timing, Worker, run_worker

__all__ = [
    "BuildLimits",
    "EmbeddedWorker",
    "Job",
    "JobKind",
    "JobOptions",
    "JobQueue",
    "JobState",
    "MappingPipeline",
    "MappingTask",
    "PendingRecording",
    "Pipeline",
    "RecordedWaypoint",
    "RecordingEntry",
    "RecordingNotes",
    "RecordingStore",
    "Timing",
    "Upload",
    "UploadStore",
    "Worker",
    "correct_waypoints",
    "corrected_waypoints",
    "has_thumbnail",
    "read_notes",
    "read_thumbnail",
    "run_worker",
]
