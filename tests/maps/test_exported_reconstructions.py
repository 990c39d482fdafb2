"""Maps as reconstructions of other programs: what is written there is what the map knows."""

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest

from rholoc.errors import InvalidInput
from rholoc.exports import ExportFormat, export_map
from rholoc.exports.reconstructions import reprojection_errors_px
from rholoc.geometry import Camera
from rholoc.maps import Map, without_memory
from rholoc.recordings import read_recording


@pytest.fixture(scope="module")
def hall(point_room: Any) -> Map:
    """A small map that remembers its observations."""
    return point_room.map_of(point_room.walk(60)[:12], "walk")


def written(map_: Map, form: ExportFormat) -> bytes:
    return b"".join(export_map(map_, form))


def with_distortion(map_: Map, *distortion: float) -> Map:
    sources = [replace(source, camera=replace(map_.info.camera, distortion=distortion)) for source in map_.info.sources]
    return replace(map_, info=replace(map_.info, sources=tuple(sources)))


def with_camera(map_: Map, camera: Camera) -> Map:
    sources = tuple(replace(source, camera=camera) for source in map_.info.sources)
    return replace(map_, info=replace(map_.info, sources=sources))


def unpacked(map_: Map, folder: Path) -> Path:
    with zipfile.ZipFile(io.BytesIO(written(map_, ExportFormat.COLMAP))) as archive:
        archive.extractall(folder)
    return folder / "sparse" / "0"


def blank_pictures(map_: Map, folder: Path) -> None:
    (folder / "images").mkdir()
    camera = map_.info.camera
    for view in range(len(map_.views)):
        picture = np.zeros((camera.height, camera.width, 3), np.uint8)
        assert cv2.imwrite(str(folder / "images" / f"{view:06d}.jpg"), picture)


@pytest.mark.parametrize("distortion", [(), (0.02, -0.01, 1e-3, -1e-3), (0.02, -0.01, 0.0, 0.0, 0.003)])
def test_colmap_reads_a_map_back_with_the_same_reprojection_error(
    hall: Map, tmp_path: Path, distortion: tuple[float, ...]
) -> None:
    map_ = with_distortion(hall, *distortion)
    model = pycolmap.Reconstruction(unpacked(map_, tmp_path))
    seen_often = np.bincount(map_.observations.features, minlength=len(map_)) >= 2
    used = seen_often[map_.observations.features]
    assert (model.num_images(), model.num_points3D()) == (len(map_.views), seen_often.sum())
    assert model.compute_num_observations() == used.sum()
    errors = reprojection_errors_px(map_)[used]
    by_point = np.bincount(map_.observations.features[used], errors) / np.maximum(
        np.bincount(map_.observations.features[used]), 1
    )
    assert model.compute_mean_reprojection_error() == pytest.approx(by_point[by_point > 0].mean(), rel=1e-4)
    model.update_point_3d_errors()  # by COLMAP's own camera model and poses
    assert model.compute_mean_reprojection_error() == pytest.approx(by_point[by_point > 0].mean(), rel=1e-3)
    first = next(iter(model.points3D.values()))
    assert len(first.track.elements) >= 2


def test_a_colmap_model_of_a_map_reads_back_as_a_recording(hall: Map, tmp_path: Path) -> None:
    unpacked(hall, tmp_path)
    blank_pictures(hall, tmp_path)
    recording = read_recording(tmp_path)
    np.testing.assert_allclose(recording.poses.T_map_camera, hall.views.T_map_camera, atol=1e-6)
    assert recording.camera.cx == pytest.approx(hall.info.camera.cx)


def test_transforms_of_a_map_read_back_as_a_recording(hall: Map, tmp_path: Path) -> None:
    (tmp_path / "transforms.json").write_bytes(written(hall, ExportFormat.NERFSTUDIO))
    blank_pictures(hall, tmp_path)
    recording = read_recording(tmp_path)
    np.testing.assert_allclose(recording.poses.T_map_camera, hall.views.T_map_camera, atol=1e-9)
    assert recording.camera.matrix == pytest.approx(hall.info.camera.matrix)


def test_what_a_lens_has_no_name_for_is_refused(hall: Map) -> None:
    five = json.loads(written(with_distortion(hall, 0.1, 0.2, 0.01, 0.02, 0.3), ExportFormat.NERFSTUDIO))
    assert [five["frames"][0][name] for name in ("k1", "k2", "p1", "p2", "k3")] == [0.1, 0.2, 0.01, 0.02, 0.3]
    with pytest.raises(InvalidInput, match=r"rational distortion.*as colmap"):
        written(with_distortion(hall, 0.1, 0.2, 0.0, 0.0, 0.3, 0.1, 0.0, 0.0), ExportFormat.NERFSTUDIO)


def test_a_panorama_has_nerfstudios_focal_lengths(hall: Map) -> None:
    width, height = 2 * hall.info.camera.height, hall.info.camera.height
    whole = Camera.panorama(width, height)
    frame = json.loads(written(with_camera(hall, whole), ExportFormat.NERFSTUDIO))["frames"][0]
    assert [frame[name] for name in ("fl_x", "fl_y", "cx", "cy")] == [width / 2, height, width / 2, height / 2]
    part = replace(whole, height=height - 10)
    for form in (ExportFormat.NERFSTUDIO, ExportFormat.COLMAP):
        with pytest.raises(InvalidInput, match="panorama that is not whole"):
            written(with_camera(hall, part), form)


@pytest.mark.parametrize("turned", [1, None], ids=["one view", "all views"])
def test_a_landmark_behind_a_camera_has_the_mean_error_of_its_other_views(
    hall: Map, tmp_path: Path, turned: int | None
) -> None:
    seen, T = hall.observations, hall.views.T_map_camera.copy()
    feature = int(np.argmax(np.bincount(seen.features)))
    rows = np.flatnonzero(seen.features == feature)
    T[seen.views[rows[:turned]]] @= np.diag([-1.0, 1, -1, 1])  # the landmark is behind them now
    map_ = replace(hall, views=replace(hall.views, T_map_camera=T))
    known = reprojection_errors_px(map_)[rows[len(rows[:turned]) :]]
    lines = (unpacked(map_, tmp_path) / "points3D.txt").read_text().splitlines()
    (error,) = [float(line.split()[7]) for line in lines if line.startswith(f"{feature + 1} ")]
    assert error == pytest.approx(known.mean() if len(known) else 0.0, rel=1e-4)


def test_a_map_without_observations_is_no_colmap_model(hall: Map) -> None:
    with pytest.raises(InvalidInput, match="does not keep what it was built from"):
        written(without_memory(hall), ExportFormat.COLMAP)
    assert json.loads(written(without_memory(hall), ExportFormat.NERFSTUDIO))["frames"]
