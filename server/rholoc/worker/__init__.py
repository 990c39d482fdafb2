"""Workers: take jobs from the queue and turn recordings into maps."""

from rholoc.worker.embedded import EmbeddedWorker
from rholoc.worker.setup import BuildLimits, WorkerSetup
from rholoc.worker.timing import Timing

__all__ = ["BuildLimits", "EmbeddedWorker", "Timing", "WorkerSetup"]
