"""What trajectories and maps report about themselves: stored in map files, sent over HTTP, read by people.

Dataclasses without behaviour, one module a subject. Every package may use them; they use none.
"""

from rholoc.reports.json import report_from_json, report_to_json
from rholoc.reports.trajectory import (
    CalibrationReport,
    ImuReport,
    InertialComparison,
    TrajectoryReport,
)

__all__ = [
    "CalibrationReport",
    "ImuReport",
    "InertialComparison",
    "TrajectoryReport",
    "report_from_json",
    "report_to_json",
]
