"""Reports on recordings, trajectories and maps: stored in map files, sent over HTTP, read by people.

Dataclasses without behaviour, one module a subject. Every package may use them; they use none.
"""

from rholoc.reports.json import report_from_json, report_to_json
from rholoc.reports.map import CoverageReport, ExpectedError, HeldOutReport, LearningReport, MapReport, QueriesReport
from rholoc.reports.trajectory import (
    CalibrationReport,
    ImuReport,
    InertialComparison,
    MissingSpan,
    TrajectoryReport,
)
from rholoc.reports.walk import Advice, AdviceKind, CoachingReport, RecordingWarning, WalkFigures, WarningKind

__all__ = [
    "Advice",
    "AdviceKind",
    "CalibrationReport",
    "CoachingReport",
    "CoverageReport",
    "ExpectedError",
    "HeldOutReport",
    "ImuReport",
    "InertialComparison",
    "LearningReport",
    "MapReport",
    "MissingSpan",
    "QueriesReport",
    "RecordingWarning",
    "TrajectoryReport",
    "WalkFigures",
    "WarningKind",
    "report_from_json",
    "report_to_json",
]
