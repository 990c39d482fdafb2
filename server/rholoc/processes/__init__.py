"""Other processes: starts, watches, limits and ends them, together with those that they started in turn."""

from rholoc.processes.async_program import AsyncProgram
from rholoc.processes.child import ChildDied, ChildFailed, named, run_in_child
from rholoc.processes.interrupts import interruptible
from rholoc.processes.limits import Limits, MemoryLimitExceeded, TimeLimitExceeded, machine_memory_bytes
from rholoc.processes.program import BACKGROUND_NICENESS, Program, call_when_input_ends, running_program

__all__ = [
    "BACKGROUND_NICENESS",
    "AsyncProgram",
    "ChildDied",
    "ChildFailed",
    "Limits",
    "MemoryLimitExceeded",
    "Program",
    "TimeLimitExceeded",
    "call_when_input_ends",
    "interruptible",
    "machine_memory_bytes",
    "named",
    "run_in_child",
    "running_program",
]
