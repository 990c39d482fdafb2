"""What others do with the same pictures: the optical flows of the paper's Table 1, and COLMAP.

    python benchmarks/others.py [flows] [colmap] [--write]

flows: pairs of rendered pictures of the test site, a tenth of a second apart, whose true flow follows from the room:
the median error, the share of pixels within one pixel, and the processor time as a multiple of Farnebäck's. TV-L1
needs scikit-image (`pip install scikit-image`). colmap: COLMAP's incremental mapper, with features of its own matched
between all pairs, on the pictures that `python benchmarks/figures.py pictures` gives rholoc. With `--write` the
figures go to benchmarks/results, and from there into the documents.
"""

import importlib.util
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from figures import FRAME_PERCENT, Figure, Figures, length_cm, run, share, shuffled_pictures
from rholoc.geometry import ByteArray, FloatArray, align_poses
from rholoc.simulation import PHONE_CAMERA, Renderer, make_test_site, make_walk, render_view
from rholoc_lab.evaluation.dense_flow import DenseMethod, dense_flow

PAIRS, APART_S, WALK_S = 8, 0.1, 30.0
SAME_POINT_M = 0.02  # farther from the first picture's point, the second shows something in front of it
LEVELS, ITERATIONS, SMOOTHNESS = 5, 60, 0.02  # of Horn and Schunck, for grey levels of 0 to 1
NEIGHBOURS = np.array([[1, 2, 1], [2, 0, 2], [1, 2, 1]]) / 12


def horn_schunck(before: ByteArray, after: ByteArray) -> FloatArray:
    """Flow (H, W, 2) [px] by Horn and Schunck (1981), from coarse to fine, the second picture warped at each level."""
    grey = [cv2.cvtColor(one, cv2.COLOR_BGR2GRAY).astype(np.float32) / 255 for one in (before, after)]
    levels = [grey]
    for _ in range(LEVELS - 1):
        levels.append([cv2.pyrDown(one) for one in levels[-1]])
    flow = np.zeros((*levels[-1][0].shape, 2), np.float32)
    for first, second in reversed(levels):
        height, width = first.shape
        flow = cv2.resize(flow, (width, height)) * (width / flow.shape[1])
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=2).astype(np.float32)
        warped = cv2.remap(second, grid + flow, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        mean = (first + warped) / 2
        slopes = np.stack([cv2.Sobel(mean, cv2.CV_32F, 1, 0) / 8, cv2.Sobel(mean, cv2.CV_32F, 0, 1) / 8], axis=2)
        change, start = warped - first, flow
        for _ in range(ITERATIONS):
            smooth = cv2.filter2D(flow, -1, NEIGHBOURS, borderType=cv2.BORDER_REPLICATE)
            excess = (slopes * (smooth - start)).sum(axis=2) + change
            flow = smooth - slopes * (excess / (SMOOTHNESS**2 + (slopes**2).sum(axis=2)))[..., None]
    return flow.astype(np.float64)


def tv_l1(before: ByteArray, after: ByteArray) -> FloatArray:
    """Flow (H, W, 2) [px] by total variation and L1 (Zach et al., 2007), of scikit-image."""
    from skimage.registration import optical_flow_tvl1

    v, u = optical_flow_tvl1(
        *(cv2.cvtColor(one, cv2.COLOR_BGR2GRAY).astype(np.float32) / 255 for one in (before, after))
    )
    return np.stack([u, v], axis=2).astype(np.float64)


def lucas_kanade(before: ByteArray, after: ByteArray) -> FloatArray:
    """Flow (H, W, 2) [px] at corners by Lucas and Kanade on a pyramid; NaN elsewhere."""
    first, second = (cv2.cvtColor(one, cv2.COLOR_BGR2GRAY) for one in (before, after))
    corners = cv2.goodFeaturesToTrack(first, 1000, 0.01, 7)
    found, status, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, None)
    kept = status[:, 0] == 1
    u, v = np.round(corners[kept, 0]).astype(int).T
    flow = np.full((*first.shape, 2), np.nan)
    flow[v, u] = (found - corners)[kept, 0]
    return flow


METHODS: dict[str, Callable[[ByteArray, ByteArray], FloatArray]] = {
    "farneback": lambda before, after: dense_flow(before, after, DenseMethod.FARNEBACK),
    "dis": lambda before, after: dense_flow(before, after, DenseMethod.DIS),
    "lucas_kanade": lucas_kanade,
    "horn_schunck": horn_schunck,
} | ({"tv_l1": tv_l1} if importlib.util.find_spec("skimage") else {})


def pairs() -> Iterator[tuple[ByteArray, ByteArray, FloatArray]]:
    """Pairs of pictures of a walk, and the true flow (H, W, 2) from the first to the second; NaN where it is hidden."""
    scene, walk = make_test_site(0), make_walk(1, WALK_S, 0)
    renderer = Renderer(scene, [face.paint.albedo for face in scene.faces])
    height, width = PHONE_CAMERA.height, PHONE_CAMERA.width
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=2)
    for begins_s in np.linspace(1.0, WALK_S - 1.0, PAIRS):
        before, after = walk.poses(np.array([begins_s, begins_s + APART_S]))
        points = renderer.surface(PHONE_CAMERA, before).points
        pixels = PHONE_CAMERA.project((points.reshape(-1, 3) - after.position) @ after.R_map_camera)
        there = np.round(np.nan_to_num(pixels, nan=-1.0)).astype(int)
        inside = ((there >= 0) & (there < (width, height))).all(axis=1)
        u, v = np.clip(there, 0, (width - 1, height - 1)).T
        shown = renderer.surface(PHONE_CAMERA, after).points[v, u]
        same = inside & (np.linalg.norm(shown - points.reshape(-1, 3), axis=1) < SAME_POINT_M)
        flow = np.where(same[:, None], pixels - grid.reshape(-1, 2), np.nan).reshape(height, width, 2)
        yield render_view(scene, PHONE_CAMERA, before, seed=1), render_view(scene, PHONE_CAMERA, after, seed=2), flow


def flows(_: Path) -> Figures:
    """How exact the flows are, and what they cost beside Farnebäck's."""
    errors: dict[str, list[FloatArray]] = {name: [] for name in METHODS}
    seconds: dict[str, float] = dict.fromkeys(METHODS, 0.0)
    moved = []
    for before, after, truth in pairs():
        moved.append(np.linalg.norm(truth, axis=2).ravel())
        for name, method in METHODS.items():
            began = time.process_time()
            flow = method(before, after)
            seconds[name] += time.process_time() - began
            off = np.linalg.norm(flow - truth, axis=2)
            errors[name].append(off[np.isfinite(off)])
    found: Figures = {"flows.motion_px": Figure(round(float(np.nanmedian(np.concatenate(moved))), 1), 0.1, False)}
    for name in METHODS:
        off_px = np.concatenate(errors[name])
        found[f"flows.{name}.median_px"] = Figure(round(float(np.median(off_px)), 2), 0.05, False)
        found[f"flows.{name}.within_1px_percent"] = Figure(
            round(100 * float((off_px < 1).mean()), 1), FRAME_PERCENT, True
        )
        found[f"flows.{name}.to_farneback_ratio"] = Figure(round(seconds[name] / seconds["farneback"], 2), 1.0, False)
    return found


def colmap(_: Path) -> Figures:
    """COLMAP on every tenth picture of the kitchen, shuffled, without times, poses or intrinsics."""
    with tempfile.TemporaryDirectory() as name:
        folder, pictures = Path(name), Path(name) / "pictures"
        pictures.mkdir()
        truth = shuffled_pictures(pictures)
        began = time.process_time()
        database = folder / "colmap.db"
        pycolmap.extract_features(database, pictures, camera_mode=pycolmap.CameraMode.SINGLE)
        pycolmap.match_exhaustive(database)
        models = pycolmap.incremental_mapping(database, pictures, folder / "models")
        minutes = (time.process_time() - began) / 60
    largest = max(models.values(), key=lambda model: model.num_reg_images())
    images = [image for image in largest.images.values() if image.has_pose]
    rows = np.array([int(Path(image.name).stem) for image in images])
    T = np.array([np.vstack([image.cam_from_world().inverse().matrix(), [0, 0, 0, 1]]) for image in images])
    placed = align_poses(T, truth[rows]).poses(T)
    off_cm = 100 * np.linalg.norm(placed[:, :3, 3] - truth[rows, :3, 3], axis=1)
    return {
        "colmap.placed_percent": share(np.isin(np.arange(len(truth)), rows), 0),
        "colmap.median_cm": length_cm(float(np.median(off_cm)), 0.2),
        "colmap.cpu_minutes": Figure(round(minutes, 1), 1.0, False),
    }


PARTS = {"flows": flows, "colmap": colmap}


if __name__ == "__main__":
    run(__doc__, PARTS)
