"""Report on intrinsics estimated from a walk."""

from __future__ import annotations

import math

from rholoc.geometry import Camera
from rholoc.reports import CalibrationReport

_MAX_FOCAL_SIGMA = 0.03  # relative, of a focal length that counts as known
_FEWEST = 6  # pictures: of four, the focal length was off by five of its standard deviations, 13 %


def calibration_report(camera: Camera, focal_sigma_px: float, pictures: int) -> CalibrationReport:
    """Report on intrinsics estimated with the poses; observable if the focal length is known to 3 % by six pictures or
    more.

    Args:
        camera: the estimate.
        focal_sigma_px: standard deviation of its focal length; may be NaN.
        pictures: number of those with a pose.
    """
    share = focal_sigma_px / camera.focal
    observable = share <= _MAX_FOCAL_SIGMA and pictures >= _FEWEST
    if pictures < _FEWEST:
        why = f"{pictures} pictures leave the camera's focal length open: take a dozen, or calibrate the camera."
    elif observable:
        why = f"Focal length and distortion were estimated from the walk, the focal length to ±{share:.1%}."
    else:
        by = f" by ±{share:.1%}" if math.isfinite(share) else ""
        why = (
            f"The walk leaves the camera's focal length open{by}: turn and walk sideways, not only ahead, "
            "or calibrate the camera."
        )
    return CalibrationReport(camera.focal, focal_sigma_px, None, observable, why)
