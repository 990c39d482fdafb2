"""Report on intrinsics estimated from a walk."""

from __future__ import annotations

import math

from rholoc.geometry import Camera
from rholoc.reports import CalibrationReport

_MAX_FOCAL_SIGMA = 0.03  # relative, of a focal length that counts as known


def calibration_report(camera: Camera, focal_sigma_px: float) -> CalibrationReport:
    """Report on intrinsics estimated with the poses; observable if the focal length is known to 3 %.

    Args:
        camera: the estimate.
        focal_sigma_px: standard deviation of its focal length; may be NaN.
    """
    share = focal_sigma_px / camera.focal
    observable = share <= _MAX_FOCAL_SIGMA
    if observable:
        why = f"Focal length and distortion were estimated from the walk, the focal length to ±{share:.1%}."
    else:
        by = f" by ±{share:.1%}" if math.isfinite(share) else ""
        why = (
            f"The walk leaves the camera's focal length open{by}: turn and walk sideways, not only ahead, "
            "or calibrate the camera."
        )
    return CalibrationReport(camera.focal, focal_sigma_px, None, observable, why)
