"""Frame → pose: seeds, ascent, confidence."""

from rholoc.localization.confidence import MIN_CONFIDENCE
from rholoc.localization.localizer import Localizer
from rholoc.localization.types import Dof, Localization, Prior, Query, Reason

__all__ = ["MIN_CONFIDENCE", "Dof", "Localization", "Localizer", "Prior", "Query", "Reason"]
