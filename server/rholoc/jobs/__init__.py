"""Mapping jobs, their queue, and the uploads that become jobs."""

from rholoc.jobs.job import Capacity, Job, JobKind, JobOptions, JobPriority, JobState, MoreMemoryNeeded, Obstacle
from rholoc.jobs.queue import JobQueue
from rholoc.jobs.uploads import Upload, UploadStore

__all__ = [
    "Capacity",
    "Job",
    "JobKind",
    "JobOptions",
    "JobPriority",
    "JobQueue",
    "JobState",
    "MoreMemoryNeeded",
    "Obstacle",
    "Upload",
    "UploadStore",
]
