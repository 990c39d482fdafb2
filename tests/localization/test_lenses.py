"""Maps of wide lenses: views, landmarks, patches and answers, and pictures of one lens in the map of another."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rholoc.geometry import Camera, Lens, pose_distances
from rholoc.localization import Intrinsics, Localizer, Query
from rholoc.localization.several_frames import SeveralFrames, localize_together
from rholoc.maps import Map, load_map, save_map

FISHEYE = Camera(800, 800, 254.0, 254.0, 399.5, 399.5, (0.001, 0.03, -0.03, 0.005), Lens.FISHEYE)
PANORAMA = Camera.panorama(1632, 816)
PINHOLE = Camera(640, 480, 520.0, 520.0, 319.5, 239.5)
CAMERAS = {camera.lens.value: camera for camera in (FISHEYE, PANORAMA, PINHOLE)}


@pytest.fixture(scope="module")
def rooms(point_room: Any) -> dict[str, Any]:
    """The room as each camera sees it."""
    return {name: replace(point_room, camera=camera) for name, camera in CAMERAS.items()}


@pytest.fixture(scope="module")
def maps(rooms: dict[str, Any]) -> dict[str, Map]:
    """Its map by each camera."""
    return {name: room.map_of(room.walk(20), name) for name, room in rooms.items()}


@pytest.mark.parametrize(
    ("mapped", "asked"),
    [
        ("fisheye", "fisheye"),
        ("equirectangular", "equirectangular"),
        ("equirectangular", "pinhole"),
        ("pinhole", "fisheye"),
        ("fisheye", "equirectangular"),
        *(
            pytest.param(*lenses, marks=pytest.mark.slow)
            for lenses in (
                ("pinhole", "pinhole"),
                ("pinhole", "equirectangular"),
                ("fisheye", "pinhole"),
                ("equirectangular", "fisheye"),
            )
        ),
    ],
)
def test_any_lens_localizes_in_the_map_of_any(
    rooms: dict[str, Any], maps: dict[str, Map], mapped: str, asked: str
) -> None:
    localizer, room = Localizer(maps[mapped]), rooms[asked]
    off_m, off_rad = [], []
    for seed, pose in enumerate(room.walk(9, sideways_m=0.15)[1::2]):
        answer = localizer.localize(Query(room.see(pose, 500 + seed), room.camera))
        assert answer.localized
        apart_m, turned_rad = pose_distances(answer.pose.T_map_camera, pose.T_map_camera)
        off_m.append(float(apart_m))
        off_rad.append(float(turned_rad))
    assert np.median(off_m) < 0.02
    assert np.median(np.degrees(off_rad)) < 0.3


@pytest.mark.parametrize("lens", ["fisheye", "equirectangular"])
def test_a_map_keeps_its_lens_and_its_pixels(maps: dict[str, Map], lens: str, tmp_path: Path) -> None:
    save_map(maps[lens], tmp_path / "room.rho")
    back = load_map(tmp_path / "room.rho")
    assert back.info.camera == CAMERAS[lens]
    kept, written = back.observations.pixels, maps[lens].observations.pixels
    assert kept is not None
    np.testing.assert_allclose(kept, written, atol=0.05)


@pytest.mark.parametrize("lens", CAMERAS)
def test_patches_are_those_of_the_room(rooms: dict[str, Any], maps: dict[str, Map], lens: str) -> None:
    turned_deg, off_octaves = rooms[lens].patch_errors(maps[lens])
    assert np.nanmedian(turned_deg) < 12
    assert np.nanmedian(off_octaves) < 0.2


def test_two_fisheyes_back_to_back_are_localized_together(rooms: dict[str, Any], maps: dict[str, Map]) -> None:
    room, localizer = rooms["fisheye"], Localizer(maps["fisheye"])
    pose = room.walk(9, sideways_m=0.15)[4]
    T_front_back = np.diag([-1.0, 1.0, -1.0, 1.0])
    T_front_back[2, 3] = -0.05
    back = replace(pose, T_map_camera=pose.T_map_camera @ T_front_back)
    frames = tuple(Query(room.see(one, 40 + k), room.camera) for k, one in enumerate((pose, back)))
    found = localize_together(localizer, SeveralFrames(frames, np.stack([np.eye(4), T_front_back])))
    assert pose_distances(found.first.pose.T_map_camera, pose.T_map_camera)[0] < 0.02


def test_a_focal_length_is_estimated_of_pinholes_only(rooms: dict[str, Any], maps: dict[str, Map]) -> None:
    """A fisheye whose focal length is wrong is taken as it was given."""
    room = rooms["fisheye"]
    query = Query(room.see(room.walk(9)[4], 7), room.camera.zoomed(1.3), intrinsics=Intrinsics.GIVEN)
    answer = Localizer(maps["fisheye"]).localize(query)
    assert answer.camera is None
