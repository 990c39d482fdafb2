"""PLY, VTP, glTF and the picture from above."""

import io
import json
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput
from rholoc.geometry import angles_between
from rholoc.mapping.build.self_report import map_statistics
from rholoc.maps import (
    Cloud,
    Map,
    MapNames,
    MapViews,
    NamedPoint,
    landmark_sigmas,
    load_map,
    map_surfaces_vtp,
    map_to_gltf,
    map_to_ply,
    map_to_scene,
    map_to_vtp,
    packed_patches,
    save_map,
    storable_patches,
    unpacked_patches,
)
from rholoc.maps.map_tables import UNKNOWN_GREY, MapTable
from rholoc.maps.walks import consecutive
from rholoc.pictures.map_preview import preview_png
from same_maps import assert_same_tables


def numbers(element: ElementTree.Element | None) -> np.ndarray:
    return np.array((element.text or "").split(), dtype=float)


def test_ply_holds_landmarks_then_views(room_map: Map) -> None:
    header, _, body = map_to_ply(room_map).decode().partition("end_header\n")
    features, views = len(room_map), len(room_map.views)
    assert f"element vertex {features + views}\n" in header
    assert f"element edge {views - 1}\n" in header
    properties = [line.split()[-1] for line in header.splitlines() if line.startswith("property float")]
    lines = body.splitlines()
    assert len(lines) == features + views + views - 1
    vertices = np.loadtxt(lines[: features + views])
    np.testing.assert_allclose(vertices[:features, :3], room_map.landmarks.positions, atol=1e-5)
    sigma = vertices[:features, properties.index("sigma_m")]
    np.testing.assert_allclose(sigma, landmark_sigmas(room_map), atol=1e-5)
    np.testing.assert_allclose(vertices[features:, :3], room_map.views.positions, atol=1e-5)
    np.testing.assert_array_equal(np.loadtxt(lines[features + views :])[0], [features, features + 1])


def test_vtp_holds_landmarks_and_the_path(room_map: Map) -> None:
    landmarks, path = ElementTree.fromstring(map_to_vtp(room_map)).iter("Piece")
    assert int(landmarks.attrib["NumberOfPoints"]) == int(landmarks.attrib["NumberOfVerts"]) == len(room_map)
    assert int(path.attrib["NumberOfPoints"]) == len(room_map.views)
    points = numbers(landmarks.find("Points/DataArray")).reshape(-1, 3)
    np.testing.assert_allclose(points, room_map.landmarks.positions, atol=1e-5)
    sigmas = numbers(landmarks.find("PointData/DataArray[@Name='sigma_m']"))
    np.testing.assert_allclose(sigmas, landmark_sigmas(room_map), atol=1e-5)
    connectivity = numbers(path.find("Lines/DataArray[@Name='connectivity']")).reshape(-1, 2)
    np.testing.assert_array_equal(connectivity, consecutive(room_map.views.walks))


def test_views_in_no_order_are_not_joined(room_map: Map) -> None:
    """The file joined pictures of a shuffled set across the room."""
    order = np.random.default_rng(0).permutation(len(room_map.views))
    shuffled = replace(room_map, views=room_map.views.take(order))
    assert b"element edge 0\n" in map_to_ply(shuffled)
    _, views = ElementTree.fromstring(map_to_vtp(shuffled)).iter("Piece")
    assert int(views.attrib["NumberOfLines"]) == 0


@pytest.mark.parametrize(("features", "views"), [(0, 0), (0, 1), (1, 0), (3, 1), (5, 2)])
def test_small_maps_export(make_map, features: int, views: int) -> None:
    map_ = make_map(features=features, views=views)
    assert map_to_ply(map_).count(b"\n") > 5
    pieces = list(ElementTree.fromstring(map_to_vtp(map_)).iter("Piece"))
    assert [int(piece.attrib["NumberOfPoints"]) for piece in pieces] == [features, views]
    assert Image.open(io.BytesIO(preview_png(map_))).size == (1200, 900)


def test_sigma_is_the_root_mean_variance(room_map: Map) -> None:
    covariances = np.tile(np.diag([1e-4, 4e-4, 7e-4]), (len(room_map), 1, 1))
    np.testing.assert_allclose(
        landmark_sigmas(replace(room_map, landmarks=replace(room_map.landmarks, covariances=covariances))),
        0.02,
        rtol=1e-6,
    )


def test_the_picture_shows_landmarks_path_and_waypoints(room_map: Map) -> None:
    with_all = np.asarray(Image.open(io.BytesIO(preview_png(room_map, "room"))).convert("RGB")).astype(int)
    marked = np.abs(with_all - (0xD1, 0x49, 0x5B)).sum(axis=2) < 12
    without = replace(room_map, info=replace(room_map.info, waypoints=()))
    bare = np.asarray(Image.open(io.BytesIO(preview_png(without, "room"))).convert("RGB")).astype(int)
    assert marked.sum() > 100
    assert (np.abs(bare - (0xD1, 0x49, 0x5B)).sum(axis=2) < 12).sum() == 0
    assert (with_all.sum(axis=2) < 600).mean() > 0.005


def test_matplotlib_is_loaded_for_pictures_alone() -> None:
    code = "import sys, rholoc.maps, rholoc.mapping, rholoc.localization; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_one_far_landmark_does_not_shrink_the_picture(make_map) -> None:
    map_ = make_map(features=400)
    far = map_.landmarks.positions.copy()
    far[0] = (5000, 5000, 0)
    plain, stretched = (
        np.asarray(Image.open(io.BytesIO(preview_png(m))).convert("L"))
        for m in (map_, replace(map_, landmarks=replace(map_.landmarks, positions=far)))
    )
    assert (stretched < 200).mean() > 0.7 * (plain < 200).mean()


def test_colours_are_in_the_ply_and_in_the_scene(room_map: Map) -> None:
    colours = np.random.default_rng(0).integers(0, 256, (len(room_map), 3), dtype=np.uint8)
    coloured = replace(room_map, landmarks=replace(room_map.landmarks, colours=colours))
    lines = map_to_ply(coloured).decode().splitlines()
    assert [line.split()[-1] for line in lines if line.startswith("property uchar")] == [
        "channel", "red", "green", "blue",
    ]  # fmt: skip
    row = lines[lines.index("end_header") + 1].split()
    assert row[-3:] == [str(value) for value in colours[0]]
    assert b"red" not in map_to_ply(room_map)
    plain, whole = map_to_scene(room_map), map_to_scene(coloured)
    assert whole[: len(plain)] == plain
    assert whole[len(plain) :] == colours.tobytes()
    few = map_to_scene(coloured, 7)
    assert np.frombuffer(few, "<u4", 1)[0] == 7
    assert few.endswith(colours[np.arange(7) * len(room_map) // 7].tobytes())


def test_a_second_reconstruction_is_in_the_scene_and_in_the_file(room_map: Map, tmp_path: Path) -> None:
    second = room_map.views.positions.astype(np.float32) + np.float32(0.5)
    second[1] = np.nan
    checked = replace(room_map, views=replace(room_map.views, second_positions=second))
    plain, whole = map_to_scene(room_map, 7), map_to_scene(checked, 7)
    assert whole == plain + 3 * 7 * b"\x80" + second.tobytes(), "grey, where colours are not known"
    turned = map_to_scene(checked, 7, np.diag([-1.0, -1.0, 1.0]))
    np.testing.assert_array_equal(np.frombuffer(turned[-second.nbytes :], "<f4").reshape(-1, 3), second * [-1, -1, 1])
    save_map(checked, tmp_path / "room.rho")
    np.testing.assert_array_equal(load_map(tmp_path / "room.rho").views.second_positions, second)


def test_gltf_holds_coloured_landmarks_and_each_walk(room_map: Map) -> None:
    colours = np.random.default_rng(0).integers(0, 256, (len(room_map), 3), dtype=np.uint8)
    names = MapNames(points=(NamedPoint("door", (1.0, 2.0, 0.5)),))
    coloured = replace(
        room_map, info=replace(room_map.info, names=names), landmarks=replace(room_map.landmarks, colours=colours)
    )
    content = map_to_gltf(coloured)
    magic, version, length, text_length, kind = struct.unpack_from("<4s3I4s", content)
    assert (magic, version, length, kind) == (b"glTF", 2, len(content), b"JSON")
    document = json.loads(content[20 : 20 + text_length])
    binary_length, binary_kind = struct.unpack_from("<I4s", content, 20 + text_length)
    binary = content[28 + text_length :]
    assert binary_kind == b"BIN\0"
    assert len(binary) == binary_length == document["buffers"][0]["byteLength"]

    def array(accessor: int, kind: str, columns: int) -> np.ndarray:
        found = document["accessors"][accessor]
        at = document["bufferViews"][found["bufferView"]]["byteOffset"]
        return np.frombuffer(binary, kind, columns * found["count"], at).reshape(-1, columns)

    landmarks, walk = (mesh["primitives"][0] for mesh in document["meshes"])
    assert (landmarks["mode"], walk["mode"]) == (0, 3)
    np.testing.assert_array_equal(array(landmarks["attributes"]["POSITION"], "<f4", 3), room_map.landmarks.positions)
    np.testing.assert_array_equal(array(landmarks["attributes"]["COLOR_0"], "u1", 4)[:, :3], colours)
    np.testing.assert_allclose(array(walk["attributes"]["POSITION"], "<f4", 3), room_map.views.positions, rtol=1e-6)
    root = document["nodes"][document["scenes"][0]["nodes"][0]]
    up = Rotation.from_quat(root["rotation"]).apply([0, 0, 1])
    np.testing.assert_allclose(up, [0, 1, 0], atol=1e-12)
    assert "door" in {document["nodes"][child]["name"] for child in root["children"]}


def test_gltf_holds_further_points_as_a_mesh_of_their_own(room_map: Map) -> None:
    cloud = Cloud(np.ones((3, 3), np.float32), np.full((3, 3), 200, np.uint8), np.zeros(3, np.int32))
    content = map_to_gltf(replace(room_map, cloud=cloud))
    document = json.loads(content[20 : 20 + struct.unpack_from("<I", content, 12)[0]])
    (mesh,) = (mesh for mesh in document["meshes"] if mesh["name"] == "further points")
    counts = [document["accessors"][accessor]["count"] for accessor in mesh["primitives"][0]["attributes"].values()]
    assert counts == [3, 3]


@pytest.mark.parametrize(("features", "views"), [(0, 0), (1, 1)])
def test_a_map_of_nothing_is_gltf_too(make_map, features: int, views: int) -> None:
    assert map_to_gltf(make_map(features=features, views=views))[:4] == b"glTF"


def test_there_is_one_figure_for_how_uncertain_landmarks_are(room_map: Map) -> None:
    shown = np.frombuffer(map_to_scene(room_map), "<f4", 4 * len(room_map), 8).reshape(-1, 4)[:, 3]
    assert map_statistics(room_map).landmark_sigma_median_m == pytest.approx(float(np.median(shown)), rel=1e-6)
    header, _, body = map_to_ply(room_map).decode().partition("end_header\n")
    column = [line.split()[-1] for line in header.splitlines() if line.startswith("property")].index("sigma_m")
    written = [float(line.split()[column]) for line in body.splitlines()[: len(room_map)]]
    np.testing.assert_allclose(written, shown, atol=1e-5)


def numbers_at(piece: ElementTree.Element, path: str) -> np.ndarray:
    return numbers(piece.find(path))


def test_surfaces_are_closed_ellipsoids_three_sigma_wide(make_map) -> None:
    map_: Map = make_map()
    map_.landmarks.covariances[7] = [[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.01]]
    surfaces, path = ElementTree.fromstring(map_surfaces_vtp(map_, [9, 7])).iter("Piece")
    points = numbers_at(surfaces, "Points/DataArray").reshape(2, -1, 3)
    triangles = numbers_at(surfaces, "Polys/DataArray[@Name='connectivity']").astype(int).reshape(2, -1, 3)
    assert surfaces.attrib["NumberOfPoints"] == str(points[..., 0].size)
    assert surfaces.attrib["NumberOfPolys"] == str(triangles[..., 0].size)
    features = numbers_at(surfaces, "CellData/DataArray[@Name='feature']").reshape(2, -1)
    np.testing.assert_array_equal(features, np.repeat([[7], [9]], features.shape[1], axis=1))
    covariance = np.array([[0.04, 0.01, 0], [0.01, 0.09, 0], [0, 0, 0.01]])
    away = points[0] - map_.landmarks.positions[7]
    distances = np.sqrt(np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away))
    np.testing.assert_allclose(distances, 3, rtol=1e-3)
    edges = {tuple(edge) for t in triangles[0] for edge in (t[[0, 1]], t[[1, 2]], t[[2, 0]])}
    assert len(edges) == 3 * len(triangles[0])
    assert {(b, a) for a, b in edges} == edges  # each edge is walked once in either direction
    volume = np.linalg.det(away[triangles[0]]).sum() / 6
    assert volume == pytest.approx(4 / 3 * np.pi * 27 * np.sqrt(np.linalg.det(covariance)), rel=0.06)
    np.testing.assert_allclose(numbers_at(path, "Points/DataArray").reshape(-1, 3), map_.views.positions, atol=1e-5)
    lines = numbers_at(path, "Lines/DataArray[@Name='connectivity']").reshape(-1, 2)
    np.testing.assert_array_equal(lines, consecutive(map_.views.walks))


@pytest.mark.parametrize(
    ("features", "says"),
    [([], "No feature"), ([60], "no feature 60"), ([-1], "no feature -1"), (range(5001), "5001 surfaces")],
)
def test_features_that_are_not_there_are_refused(room_map: Map, features, says: str) -> None:
    with pytest.raises(InvalidInput, match=says):
        map_surfaces_vtp(room_map, features)


def test_packing_keeps_directions_to_a_degree_and_lengths_to_five_percent() -> None:
    rng = np.random.default_rng(0)
    lengths = np.exp(rng.uniform(np.log(1e-4), np.log(1e3), (5000, 1)))
    units = rng.normal(size=(5000, 3))
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    rounded = unpacked_patches(packed_patches(units * lengths)).astype(np.float64)
    kept = np.linalg.norm(rounded, axis=1, keepdims=True)
    assert np.rad2deg(angles_between(rounded / kept, units)).max() < 1
    assert np.abs(np.log(kept / lengths)).max() < np.log(1.05)


def test_what_is_rounded_once_stays_as_it_is() -> None:
    coordinates = np.arange(-127, 128, dtype=np.int8)
    every = np.stack(np.meshgrid(coordinates, coordinates, np.array([-127, 3, 127], np.int8)), axis=-1).reshape(-1, 3)
    once = unpacked_patches(every)
    assert np.isfinite(once).all()
    np.testing.assert_array_equal(unpacked_patches(packed_patches(once)), once)


def test_the_axes_are_exact() -> None:
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    np.testing.assert_array_equal(unpacked_patches(packed_patches(axes)), axes)


def test_what_is_not_known_stays_unknown() -> None:
    patches = np.array([[0.1, 0, 0], [np.nan, np.nan, np.nan], [0, 0, 0]])
    np.testing.assert_array_equal(np.isnan(storable_patches(patches)).all(axis=1), [False, True, True])
    assert storable_patches(patches[1:]) is None


TABLES = ("landmarks", "descriptors", "views", "observations")


def table_of(map_: Map, name: str) -> MapTable:
    return getattr(map_, name)


@pytest.mark.parametrize("name", TABLES)
def test_parts_joined_are_the_whole(room_map: Map, name: str) -> None:
    table = table_of(room_map, name)
    first = np.arange(len(table)) < len(table) // 3
    again = type(table).concat([table.take(first), table.take(np.flatnonzero(~first))])
    assert len(table.take(first)) == len(table) // 3
    assert_same_tables(replace(room_map, **{name: again}), room_map)


@pytest.mark.parametrize("name", TABLES)
def test_every_column_is_taken(room_map: Map, name: str) -> None:
    table = table_of(room_map, name)
    rows = np.array([2, 0, 2])
    taken = table.take(rows)
    for column in table.columns():
        values = getattr(table, column)
        if values is not None:
            np.testing.assert_array_equal(getattr(taken, column), values[rows])


def test_what_one_table_does_not_know_is_unknown_in_both(room_map: Map) -> None:
    few = room_map.landmarks.take(np.arange(3))
    coloured = replace(few, colours=np.full((3, 3), 7, np.uint8))
    joined = type(few).concat([few, coloured])
    np.testing.assert_array_equal(joined.colours, np.repeat([[UNKNOWN_GREY] * 3, [7] * 3], 3, axis=0))
    assert joined.patches is None
    views = room_map.views.take(np.arange(2))
    seen = replace(views, pictures=(b"a", b"b"), sources=np.zeros(2, np.int32))
    both = MapViews.concat([views, seen])
    assert both.pictures == (b"", b"", b"a", b"b")
    assert both.take(np.array([3, 0])).pictures == (b"b", b"")
    assert both.sources is None  # unknown for some is unknown for all
    assert np.isnan(both.known_covariances).all()
    assert both.covariances is None
