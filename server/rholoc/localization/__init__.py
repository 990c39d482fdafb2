"""Frame → pose: seeds, ascent, confidence."""

from rholoc.localization.confidence import MIN_CONFIDENCE
from rholoc.localization.diagnosis import TOO_LITTLE_TIME, Cause, Diagnosis
from rholoc.localization.localizer import Localizer
from rholoc.localization.types import Dof, Intrinsics, Localization, Prior, Query, Reason

__all__ = [
    "MIN_CONFIDENCE",
    "TOO_LITTLE_TIME",
    "Cause",
    "Diagnosis",
    "Dof",
    "Intrinsics",
    "Localization",
    "Localizer",
    "Prior",
    "Query",
    "Reason",
]
