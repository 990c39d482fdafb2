"""Workers: take jobs from the queue and turn recordings into maps."""

from rholoc.worker.embedded import EmbeddedWorker
from rholoc.worker.heartbeat import Timing
from rholoc.worker.setup import BuildLimits, WorkerSetup

__all__ = ["BuildLimits", "EmbeddedWorker", "Timing", "WorkerSetup"]
