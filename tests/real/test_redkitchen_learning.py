"""A map of a real walk that learns the walk's second half, and refuses walks through other rooms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rholoc.errors import MappingFailed
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping import BuildOptions, build_map, update_map
from rholoc.mapping.edit.sources import forget_recording
from rholoc.mapping.learn.merging import merge_maps
from rholoc.maps import Map
from rholoc.recordings import read_recording
from rholoc.trajectory import PoseMethod

_CAMERA = "525.505,525.505,320,240"
_OTHERS = {
    "euroc_v101/cam0/data": "458.654,457.296,367.215,248.375,-0.28340811,0.07395907,0.00019359,0.0000176",
    "android_livingroom/video.mp4": None,
}


def first_half(real_data: Path) -> Map:
    recording = read_recording(real_data / "redkitchen", camera=_CAMERA, frames="400:700:3")
    return build_map([recording], BuildOptions(poses=PoseMethod.GIVEN, report=False))


def errors_m(map_: Map, real_data: Path) -> np.ndarray:
    """Of easy queries, metres; infinite where there is no pose."""
    queries = read_recording(real_data / "redkitchen", camera=_CAMERA, frames="200:400:10")
    localizer, errors = Localizer(map_), []
    for row, image in enumerate(queries.frames.images(list(range(len(queries.frames.times))))):
        answer = localizer.localize(Query(localizer.extractor.extract(image), queries.camera, Dof.FREE))
        true = queries.poses.T_map_camera[row, :3, 3]
        errors.append(np.inf if answer.pose is None else np.linalg.norm(answer.pose.position - true))
    return np.array(errors)


@pytest.mark.slow
@pytest.mark.real
def test_the_second_half_makes_the_map_no_worse_and_other_rooms_are_refused(real_data: Path) -> None:
    first = first_half(real_data)
    second = read_recording(real_data / "redkitchen", camera=_CAMERA, frames="700:1000:3")
    updated = update_map(first, replace(second, poses=None))
    before, after = errors_m(first, real_data), errors_m(updated, real_data)
    assert (after < 0.05).sum() >= (before < 0.05).sum() >= 0.9 * len(before)
    assert np.median(after) < np.median(before) + 0.002
    assert np.median(after) < 0.015
    left = forget_recording(updated, updated.info.sources[1].id)
    np.testing.assert_allclose(left.landmarks.positions, first.landmarks.positions, rtol=0, atol=1e-6)

    built = build_map([second], BuildOptions(poses=PoseMethod.GIVEN, report=False))
    merged = merge_maps(first, built)
    assert merged.info.report.learned[0].residual_median_m < 0.03
    assert np.median(errors_m(merged, real_data)) < np.median(before) + 0.002

    for other, camera in _OTHERS.items():
        with pytest.raises(MappingFailed, match="does not show the place"):
            update_map(first, read_recording(real_data / other, camera=camera))
