"""Recording → map: the pipeline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rholoc.maps import DensityKind, Map
from rholoc.progress import ProgressListener, silent
from rholoc.recordings import Recording
from rholoc.trajectory import PoseMethod

DEFAULT_FEATURES = "gray"


@dataclass(frozen=True)
class BuildOptions:
    """How a map is built.

    Attributes:
        density: the form of the densities.
        features: the extractor's name.
        poses: where frame poses come from.
        report: whether to hold frames out and localize them for the map's report (takes time).
    """

    density: DensityKind = DensityKind.RAY
    features: str = DEFAULT_FEATURES
    poses: PoseMethod = PoseMethod.VISUAL_INERTIAL
    report: bool = True


def build_map(
    recordings: Sequence[Recording], options: BuildOptions | None = None, progress: ProgressListener = silent
) -> Map:
    """Build a map from one or more recordings of a place.

    Raises:
        InvalidRecording: a recording cannot be read.
        InvalidWaypoints: its waypoints do not fix a frame.
        MappingFailed: too few frames could be placed, or too few features are stable; says what to do better.
        Cancelled: ``progress`` asked to stop.
    """
    raise NotImplementedError
