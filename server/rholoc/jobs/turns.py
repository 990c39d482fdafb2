"""The order in which queued jobs are taken."""

from rholoc.jobs.job import JobPriority

_DAY_S = 24 * 3600.0
_AHEAD_S = {JobPriority.HIGH: _DAY_S, JobPriority.NORMAL: 0.0, JobPriority.LOW: -_DAY_S}
_PATIENCE = 10.0  # seconds that each second of a walk delays its turn


def turn_of(submitted_s: float, priority: JobPriority, length_s: float) -> float:
    """Sort key of the queue [s]: the job with the smallest turn is taken first.

    It is the time of submission, minus or plus a day by priority, plus ten times the walk's length. Since it
    does not depend on the present time, no job waits for ever.

    Args:
        submitted_s: seconds since the epoch.
        priority: of the job.
        length_s: estimated length of the walk.
    """
    return submitted_s - _AHEAD_S[priority] + _PATIENCE * length_s


def changed_turn(turn: float, before: JobPriority, after: JobPriority) -> float:
    """The turn [s] of a job whose priority changes."""
    return turn + _AHEAD_S[before] - _AHEAD_S[after]
