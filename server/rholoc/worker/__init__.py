"""Workers: take jobs from the queue and turn recordings into maps."""

from rholoc.worker.build_process import BuildLimits
from rholoc.worker.embedded import EmbeddedWorker
from rholoc.worker.pipeline import MappingPipeline, MappingTask
from rholoc.worker.setup import WorkerSetup
from rholoc.worker.timing import Timing
from rholoc.worker.worker import run_worker

__all__ = [
    "BuildLimits",
    "EmbeddedWorker",
    "MappingPipeline",
    "MappingTask",
    "Timing",
    "WorkerSetup",
    "run_worker",
]
