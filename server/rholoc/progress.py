"""Progress of long work: the stages of mapping, and the listener to which they are reported."""

from enum import StrEnum
from typing import Protocol


class Stage(StrEnum):
    """The stages of a mapping job, in order."""

    RECEIVED = "received"  # the upload is complete and queued
    READ = "read"  # the recording's files are being read and checked
    KEYFRAMES = "keyframes"  # frames are being chosen
    FEATURES = "features"  # features are being extracted
    POSES = "poses"  # frame poses are being estimated
    OBSERVATIONS = "observations"  # observations are being linked into features
    DENSITIES = "densities"  # densities are being fitted
    REPORT = "report"  # held-out frames are being localized
    LINKS = "links"  # of a site instead: its maps are being compared
    PUBLISHED = "published"  # the map is in the library, or the site's links are stored


class ProgressListener(Protocol):
    """Receives progress. May raise :class:`rholoc.errors.Cancelled` to stop the work."""

    def __call__(self, stage: Stage, fraction: float, message: str = "") -> None:
        """Note that ``stage`` is ``fraction`` (0..1) done; ``message`` is one line for people."""


def silent(stage: Stage, fraction: float, message: str = "") -> None:
    """Ignore progress."""
