"""Report on intrinsics estimated from a walk."""

import math

import numpy as np

from rholoc.geometry import UP, Camera, angles_between, on_plane
from rholoc.reports import CalibrationReport

_MAX_FOCAL_SIGMA = 0.03  # relative, of a focal length that counts as known
_MAX_ANGLE_DEG, _MAX_BARREL = 57.0, 0.15  # off the axis, and share of its distance that distortion takes from it there
_FEWEST = 6  # pictures: of four, the focal length was off by five of its standard deviations, 13 %


def calibration_report(camera: Camera, focal_sigma_px: float, pictures: int) -> CalibrationReport:
    """Report on intrinsics estimated with the poses; observable if the focal length is known to 3 % by six pictures or
    more, and the lens is no fisheye, whose distortion two coefficients do not describe.

    Args:
        camera: the estimate.
        focal_sigma_px: standard deviation of its focal length; may be NaN.
        pictures: number of those with a pose.
    """
    share = focal_sigma_px / camera.focal
    is_fisheye = _is_fisheye(camera)
    observable = share <= _MAX_FOCAL_SIGMA and pictures >= _FEWEST and not is_fisheye
    if pictures < _FEWEST:
        why = f"{pictures} pictures leave the camera's focal length open: take a dozen, or calibrate the camera."
    elif is_fisheye:
        why = (
            "The camera's lens is a fisheye, which pictures alone do not calibrate: give its intrinsics with the lens."
        )
    elif observable:
        why = f"Focal length and distortion were estimated from the walk, the focal length to ±{share:.1%}."
    else:
        by = f" by ±{share:.1%}" if math.isfinite(share) else ""
        why = (
            f"The walk leaves the camera's focal length open{by}: turn and walk sideways, not only ahead, "
            "or calibrate the camera."
        )
    return CalibrationReport(camera.focal, focal_sigma_px, None, observable, why)


def _is_fisheye(camera: Camera) -> bool:
    """Whether a corner of the image is over 57° off the axis, and distortion draws it in by over 15 %."""
    right, bottom = camera.width - 1.0, camera.height - 1.0
    corners = np.array([[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]])
    rays = camera.rays(corners)
    ahead = rays[:, 2] > 0
    off_px = (corners - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    drawn_in = np.linalg.norm(off_px, axis=1)[ahead] < (1 - _MAX_BARREL) * np.linalg.norm(on_plane(rays[ahead]), axis=1)
    is_wide = np.degrees(angles_between(rays[ahead], UP)) > _MAX_ANGLE_DEG  # a camera's axis is z, as UP is the map's
    return bool((is_wide & drawn_in).any())
