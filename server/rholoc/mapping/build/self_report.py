"""A map's report on itself, including how consistent it is with frames that were held out while it was built."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray, pose_distances
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping.build.view_covariance import expected_error
from rholoc.maps import Map, coverage_of, landmark_sigmas
from rholoc.progress import ProgressListener, Stage
from rholoc.reports import HeldOutReport, MapReport

_MAX_HELD_OUT = 60


Frame = tuple[Camera, FloatArray, FeatureSet]
"""A frame's camera, T_map_camera (4, 4) and features."""


def map_report(map_: Map, held_out: Sequence[Frame], progress: ProgressListener) -> MapReport:
    """Report on a map: statistics of landmarks, coverage, consistency with at most 60 held-out frames (if there are
    any).

    Held-out frames are localized and compared with the trajectory's poses. This measures consistency, not truth: an
    error of the trajectory affects map and frames alike.
    """
    report = map_statistics(map_)
    if held_out:
        report = replace(report, held_out=_held_out_errors(map_, held_out, progress))
    progress(Stage.REPORT, 1.0, "report complete")
    return report


def map_statistics(map_: Map) -> MapReport:
    """Statistics of the map alone: size, precision of its landmarks, coverage."""
    sigma_m = landmark_sigmas(map_)
    return MapReport(
        features=len(map_),
        descriptors=len(map_.descriptors),
        views=len(map_.views),
        views_per_feature_median=float(np.median(np.bincount(map_.observations.features, minlength=len(map_)))),
        features_per_view_median=float(np.median(np.diff(map_.view_offsets))),
        landmark_sigma_median_m=float(np.median(sigma_m)),
        landmark_sigma_p90_m=float(np.percentile(sigma_m, 90)),
        coverage=coverage_of(map_).report(),
        expected_error=expected_error(map_),
    )


def _held_out_errors(map_: Map, held_out: Sequence[Frame], progress: ProgressListener) -> HeldOutReport:
    """Errors of the localizer on evenly chosen held-out frames."""
    localizer = Localizer(map_)
    step = max(1, -(-len(held_out) // _MAX_HELD_OUT))
    frames = held_out[::step]
    errors: list[tuple[float, float] | None] = []
    confidences = []
    for done, (camera, T_map_camera, features) in enumerate(frames):
        answer = localizer.localize(Query(features, camera, Dof.FREE))
        errors.append(None if answer.pose is None else _error(answer.pose.T_map_camera, T_map_camera))
        confidences.append(answer.confidence)
        progress(
            Stage.REPORT, (done + 1) / len(frames), f"{done + 1} of {len(frames)} frames held out, for consistency"
        )
    return _error_statistics(errors, confidences)


def _error_statistics(errors: list[tuple[float, float] | None], confidences: list[float]) -> HeldOutReport:
    """Statistics of held-out frames: errors [m, deg], None for a refused frame, and confidences, which it lists too."""
    found = [error for error in errors if error is not None]
    distances, angles = np.array(found).reshape(-1, 2).T
    return HeldOutReport(
        frames=len(errors),
        localized=len(found),
        median_m=float(np.median(distances)) if found else None,
        p90_m=float(np.percentile(distances, 90)) if found else None,
        median_deg=float(np.median(angles)) if found else None,
        recall_5cm_5deg=float(((distances < 0.05) & (angles < 5)).sum() / len(errors)),
        recall_10cm_5deg=float(((distances < 0.10) & (angles < 5)).sum() / len(errors)),
        errors_m=tuple(None if error is None else round(error[0], 5) for error in errors),
        errors_deg=tuple(None if error is None else round(error[1], 4) for error in errors),
        confidences=tuple(round(float(confidence), 4) for confidence in confidences),
    )


def _error(estimated: FloatArray, truth: FloatArray) -> tuple[float, float]:
    """Distance [m] and angle [deg] between two poses (4, 4)."""
    apart_m, turned_rad = pose_distances(estimated, truth)
    return float(apart_m), float(np.degrees(turned_rad))
