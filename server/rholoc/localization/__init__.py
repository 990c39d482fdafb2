"""Frame → pose: seeds, ascent, confidence."""

from rholoc.localization.localizer import Localizer
from rholoc.localization.types import Dof, Localization, Prior, Query, Reason

__all__ = ["Dof", "Localization", "Localizer", "Prior", "Query", "Reason"]
