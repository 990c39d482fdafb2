"""A calibration as a picture."""

import numpy as np
from matplotlib.collections import PolyCollection

from rholoc.calibration.calibrate import Calibration
from rholoc.calibration.views import outline
from rholoc.pictures.style import INK, MUTED, figure_of, png_of

_WIDTH_IN = 9.0
_DPI = 130
_EMPTY = "#f6d5d8"


def calibration_png(calibration: Calibration) -> bytes:
    """PNG of where in the image corners were seen, coloured by residual [px]; cells without corners are shaded."""
    camera = calibration.camera
    figure = figure_of((_WIDTH_IN, 1.1 + 0.86 * _WIDTH_IN * camera.height / camera.width), _DPI)
    axes = figure.add_subplot()
    covered = calibration.covered
    edges_u = np.linspace(-0.5, camera.width - 0.5, covered.shape[1] + 1)
    edges_v = np.linspace(-0.5, camera.height - 0.5, covered.shape[0] + 1)
    for row, column in np.argwhere(~covered):
        axes.fill_between(edges_u[column : column + 2], *edges_v[row : row + 2], color=_EMPTY, linewidth=0)
    outlines = [outline(view.sighting, calibration.board) for view in calibration.views]
    axes.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=MUTED, linewidths=0.5, alpha=0.6))
    pixels = np.concatenate([view.sighting.pixels for view in calibration.views])
    missed_px = np.linalg.norm(np.concatenate([view.residuals_px for view in calibration.views]), axis=1)
    order = np.argsort(missed_px)
    u, v = pixels[order].T
    points = axes.scatter(
        u, v, c=missed_px[order], s=7, cmap="viridis", vmin=0, vmax=float(np.percentile(missed_px, 98))
    )
    figure.colorbar(points, ax=axes, label="missed by, px", fraction=0.05, pad=0.01, extend="max")
    axes.plot(camera.cx, camera.cy, "+", color="#d1495b", markersize=14, markeredgewidth=1.6)
    axes.set(
        xlim=(-0.5, camera.width - 0.5),
        ylim=(camera.height - 0.5, -0.5),
        aspect="equal",
        xlabel="u, px",
        ylabel="v, px",
    )
    axes.set_title(
        f"{len(calibration.views)} views of the {calibration.board}: rms {calibration.rms_px:.2f} px, "
        f"{calibration.coverage:.0%} of the image covered\n"
        f"fx {camera.fx:.1f} ± {calibration.sigmas['fx']:.1f}, fy {camera.fy:.1f} ± {calibration.sigmas['fy']:.1f}, "
        f"cx {camera.cx:.1f} ± {calibration.sigmas['cx']:.1f}, cy {camera.cy:.1f} ± {calibration.sigmas['cy']:.1f} px",
        loc="left",
        fontsize=10,
        color=INK,
    )
    return png_of(figure)
