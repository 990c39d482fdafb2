"""Places, and the densities fitted for them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput
from rholoc.features import Metric
from rholoc.mapping import BuildOptions, build_map
from rholoc.mapping.landmarks import representative_rows, select_stable, triangulate
from rholoc.mapping.observations import Views, link_observations
from rholoc.mapping.tensor_fit import fit_map_tensors, gather_places
from rholoc.maps import DensityKind, Map, MapInfo
from rholoc.maps.tensor_arrays import tensors_of
from rholoc.progress import Stage


@pytest.fixture(scope="module")
def ray_map(walked: Views) -> Map:
    landmarks = select_stable(walked, triangulate(walked, link_observations(walked, Metric.HAMMING)), 60)
    rows = np.concatenate(representative_rows(walked, landmarks.labels, len(landmarks), Metric.HAMMING, 1))
    upper = np.triu_indices(3)
    quaternions = Rotation.from_matrix(walked.T_map_camera[:, :3, :3]).as_quat()
    observed = landmarks.observed_rows
    return Map(
        info=MapInfo("0" * 32, 1, DensityKind.RAY, "gray", True, True, "2026-01-01T00:00:00Z", walked.cameras[0]),
        channels=np.zeros(len(landmarks), np.uint8),
        landmarks=landmarks.positions.astype(np.float32),
        covariances=landmarks.covariances[:, upper[0], upper[1]].astype(np.float32),
        descriptors=walked.features.descriptors[rows],
        descriptor_features=np.arange(len(landmarks), dtype=np.int32),
        view_times=walked.times,
        view_poses=np.column_stack([walked.positions, quaternions]).astype(np.float32),
        view_offsets=np.searchsorted(walked.view_of[observed], np.arange(len(walked) + 1)).astype(np.int32),
        view_features=landmarks.labels[observed].astype(np.int32),
        extras={"eta": landmarks.eta},
    )


def test_views_from_one_side_are_one_place_and_other_sides_are_others() -> None:
    landmark = np.array([0.0, 0.0, 1.0])
    front = [[2.0, y, 1.0] for y in (-0.3, 0.0, 0.3)]
    side = [[y, 2.0, 1.0] for y in (-0.1, 0.1)]
    far = [[7.0, 0.0, 1.0], [7.5, 0.0, 1.0], [8.0, 0.1, 1.0], [7.2, 0.0, 1.0]]
    lone = [[-2.0, 0.0, 1.0]]
    places = gather_places(landmark, np.array(front + side + far + lone))
    assert [members.tolist() for members in places] == [[5, 6, 7, 8], [0, 1, 2], [3, 4]]


def test_a_feature_seen_only_once_still_has_a_place() -> None:
    assert [members.tolist() for members in gather_places(np.zeros(3), np.array([[1.0, 0, 0]]))] == [[0]]


def test_every_feature_has_a_density_that_is_valid_where_it_was_seen(ray_map: Map) -> None:
    heard: list[tuple[Stage, float]] = []
    map_ = fit_map_tensors(ray_map, progress=lambda stage, fraction, message="": heard.append((stage, fraction)))
    densities, owners = tensors_of(map_)
    assert map_.info.density is DensityKind.TENSOR
    assert set(owners) == set(range(len(ray_map)))
    assert "eta" in map_.extras
    assert heard[-1] == (Stage.DENSITIES, 1.0)
    poses = map_.view_poses.astype(float)
    headings = Rotation.from_quat(poses[:, 3:]).as_matrix()[:, :, 2]
    covered = []
    for k in range(len(poses)):
        for feature in map_.view_features[map_.view_offsets[k] : map_.view_offsets[k + 1]]:
            covered.append(densities.valid_at(poses[k, :3], headings[k], np.flatnonzero(owners == feature)).any())
    assert np.mean(covered) > 0.97


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_degree_is_as_asked(ray_map: Map, degree: int) -> None:
    assert int(fit_map_tensors(_few(ray_map), degree).extras["tensor_degree"]) == degree


def test_an_impossible_degree_is_refused() -> None:
    with pytest.raises(InvalidInput, match="degree 4"):
        build_map([], BuildOptions(density=DensityKind.TENSOR, degree=4))


def _few(map_: Map, count: int = 5) -> Map:
    kept = map_.view_features < count
    totals = np.concatenate([[0], np.cumsum(kept)])[map_.view_offsets]
    return Map(
        info=map_.info,
        channels=map_.channels[:count],
        landmarks=map_.landmarks[:count],
        covariances=map_.covariances[:count],
        descriptors=map_.descriptors[:count],
        descriptor_features=map_.descriptor_features[:count],
        view_times=map_.view_times,
        view_poses=map_.view_poses,
        view_offsets=totals.astype(np.int32),
        view_features=map_.view_features[kept],
    )
