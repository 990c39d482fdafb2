"""A camera of unknown intrinsics, from the reconstruction that it took the pictures of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pycolmap

from rholoc.geometry import Camera, FloatArray

_GUESSED_FOCALS = (0.9, 1.2)  # times the longer side: phones and webcams have 0.8 to 1.25
_MODEL = "RADIAL"  # f, cx, cy, k1, k2
_FOCAL, _CENTRE, _DISTORTION = slice(0, 1), slice(1, 3), slice(3, 5)
_MAX_CENTRE_SIGMA = 0.01  # of the image's width, beyond which the middle of the image is the better estimate
_MAX_FOCAL_SIGMA = 0.03  # relative, of a focal length that counts as known
_ITERATIONS = 40


@dataclass(frozen=True)
class SelfCalibration:
    """Intrinsics by bundle adjustment.

    Attributes:
        camera: what was found.
        focal_sigma_px: the standard deviation of the focal length, for image errors of one pixel; at least by how much
            two reconstructions differ.
        centre_sigma_px: of the principal point; None where it was not observable, and is the middle of the image.
    """

    camera: Camera
    focal_sigma_px: float
    centre_sigma_px: float | None

    @property
    def observable(self) -> bool:
        """Whether the walk fixes the focal length."""
        return self.focal_sigma_px <= _MAX_FOCAL_SIGMA * self.camera.focal

    @property
    def why(self) -> str:
        """One line on how well the intrinsics are known."""
        share = f"±{self.focal_sigma_px / self.camera.focal:.1%}"
        if self.observable:
            return f"Focal length and distortion were estimated from the walk, the focal length to {share}."
        return (
            f"The walk leaves the camera's focal length open by {share}: turn and walk sideways, not only ahead, "
            "or calibrate the camera."
        )

    @property
    def report(self) -> dict[str, Any]:
        """The figures, for the map's report."""
        return {
            "focal_px": self.camera.focal,
            "focal_sigma_px": self.focal_sigma_px,
            "centre_sigma_px": self.centre_sigma_px,
            "observable": self.observable,
            "why": self.why,
        }


def guessed_cameras(size: tuple[int, int]) -> list[pycolmap.Camera]:
    """What a reconstruction may start from, the likelier first, for images of ``size``, width and height in pixels."""
    width, height = size
    focals = [share * max(size) for share in _GUESSED_FOCALS]
    return [
        pycolmap.Camera(model=_MODEL, width=width, height=height, params=[focal, width / 2, height / 2, 0.0, 0.0])
        for focal in focals
    ]


def refine_camera(model: pycolmap.Reconstruction) -> FloatArray:
    """Adjust a reconstruction and all intrinsics of its one camera; the standard deviations of these (5,).

    The principal point is left in the middle of the image, its deviations NaN, where the walk does not show it: it is
    easily taken for a rotation.
    """
    (camera,) = model.cameras.values()
    start = np.array(camera.params)
    sigmas = _adjust(model, refine_centre=True)
    if not (sigmas[_CENTRE].max() <= _MAX_CENTRE_SIGMA * camera.width):
        camera.params = start
        sigmas = _adjust(model, refine_centre=False)
    return sigmas


def self_calibration(
    parameters: FloatArray, sigmas: FloatArray, other_focal: float | None, size: tuple[int, int]
) -> SelfCalibration:
    """What is known of the camera, from its parameters (5,) as COLMAP has them and their deviations.

    ``other_focal`` is a second estimate, from other keyframes.
    """
    focal, cx, cy, k1, k2 = (float(value) for value in parameters)
    camera = Camera(*size, fx=focal, fy=focal, cx=cx - 0.5, cy=cy - 0.5, distortion=(k1, k2, 0.0, 0.0))
    centre_sigma_px = float(sigmas[_CENTRE].max())
    found = SelfCalibration(camera, float(sigmas[0]), centre_sigma_px if np.isfinite(centre_sigma_px) else None)
    if other_focal is None:
        return found
    return replace(found, focal_sigma_px=max(found.focal_sigma_px, abs(focal - other_focal)))


def _adjust(model: pycolmap.Reconstruction, refine_centre: bool) -> FloatArray:
    """Bundle adjustment over everything; the deviations of the camera's parameters (5,), infinite where it failed."""
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.reg_image_ids():
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = refine_centre
    options.print_summary = False
    options.ceres.solver_options.max_num_iterations = _ITERATIONS
    options.ceres.solver_options.num_threads = 1
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, model)
    adjuster.solve()
    (camera,) = model.cameras.values()
    wanted = pycolmap.BACovarianceOptions()
    wanted.params = pycolmap.BACovarianceOptionsParams.ALL
    covariance = pycolmap.estimate_ba_covariance(wanted, model, adjuster)
    found = None if covariance is None else covariance.get_other_params_cov(camera.params)
    sigmas = np.full(len(camera.params), np.inf)
    if not refine_centre:
        sigmas[_CENTRE] = np.nan
    if found is not None:
        sigmas[np.isinf(sigmas)] = np.sqrt(np.diag(found))
    return sigmas
