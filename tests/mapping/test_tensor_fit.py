"""Places, and the densities fitted for them."""

import numpy as np
import pytest

from rholoc.density.localities import gather_places
from rholoc.errors import InvalidInput
from rholoc.features import Metric
from rholoc.mapping import BuildOptions, build_map
from rholoc.mapping.build.density_fitting import fit_densities
from rholoc.mapping.build.landmarks import are_stable, representative_rows, triangulate
from rholoc.mapping.build.tracks import Views, link_observations
from rholoc.maps import DensityKind, Map, MapDescriptors, MapInfo, MapLandmarks, MapObservations, MapViews
from rholoc.progress import Stage


@pytest.fixture(scope="module")
def ray_map(walked: Views) -> Map:
    landmarks = triangulate(walked, link_observations(walked, Metric.HAMMING))
    landmarks = landmarks.keep(are_stable(walked, landmarks, 60))
    rows = np.concatenate(representative_rows(walked, landmarks.labels, len(landmarks), Metric.HAMMING, 1))
    observed = landmarks.observed_rows
    return Map(
        info=MapInfo("0" * 32, 1, DensityKind.RAY, "gray", True, True, "2026-01-01T00:00:00Z", walked.cameras[0]),
        landmarks=MapLandmarks(
            channels=np.zeros(len(landmarks), np.uint8),
            positions=landmarks.positions.astype(np.float32),
            covariances=landmarks.covariances.astype(np.float32),
        ),
        descriptors=MapDescriptors(
            values=walked.features.descriptors[rows], features=np.arange(len(landmarks), dtype=np.int32)
        ),
        views=MapViews(times=walked.times, T_map_camera=walked.T_map_camera),
        observations=MapObservations(
            views=walked.view_of[observed].astype(np.int32), features=landmarks.labels[observed].astype(np.int32)
        ),
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
    map_ = fit_densities(
        ray_map, DensityKind.TENSOR, progress=lambda stage, fraction, message="": heard.append((stage, fraction))
    )
    densities = map_.densities
    assert map_.info.density is DensityKind.TENSOR
    assert set(densities.features) == set(range(len(ray_map)))
    assert heard[-1] == (Stage.DENSITIES, 1.0)
    covered = []
    for k, feature in zip(map_.observations.views, map_.observations.features, strict=True):
        rows = np.flatnonzero(densities.features == feature)
        covered.append(densities.valid_at(map_.views.positions[k], map_.views.headings[k], rows).any())
    assert np.mean(covered) > 0.97


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_degree_is_as_asked(ray_map: Map, degree: int) -> None:
    fitted = fit_densities(_few(ray_map), DensityKind.TENSOR, degree).densities
    assert fitted.degree == degree


def test_an_impossible_degree_is_refused() -> None:
    with pytest.raises(InvalidInput, match="degree 4"):
        build_map([], BuildOptions(density=DensityKind.TENSOR, degree=4))


def _few(map_: Map, count: int = 5) -> Map:
    kept = map_.observations.features < count
    return Map(
        info=map_.info,
        landmarks=MapLandmarks(
            channels=map_.landmarks.channels[:count],
            positions=map_.landmarks.positions[:count],
            covariances=map_.landmarks.covariances[:count],
        ),
        descriptors=MapDescriptors(values=map_.descriptors.values[:count], features=map_.descriptors.features[:count]),
        views=MapViews(times=map_.views.times, T_map_camera=map_.views.T_map_camera),
        observations=MapObservations(views=map_.observations.views[kept], features=map_.observations.features[kept]),
    )
