"""The native map file: what is written is read back, and what is damaged is refused."""

import errno
import json
import os
import struct
import time
from dataclasses import astuple, fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.numpy import save_file

from rholoc.density.tensor import fit_tensors
from rholoc.errors import InvalidInput, InvalidMap, RholocError, StorageFull, UnknownMap
from rholoc.maps import (
    DensityKind,
    Map,
    MapDescriptors,
    MapLandmarks,
    MapObservations,
    MapViews,
    Source,
    load_map,
    map_to_bytes,
    packed_pixels,
    save_map,
    storable_patches,
    unpacked_pixels,
)
from rholoc.maps.formats.rho_file import _DESCRIPTORS, _LANDMARKS, _VIEWS, _checksum, load_outline
from rholoc.maps.info import info_from_json, info_to_json
from rholoc.reports import MapReport
from same_maps import assert_same_tables

_SHARED_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)


def assert_same_map(a: Map, b: Map) -> None:
    assert a.info == b.info
    assert_same_tables(a, b, pose_tolerance=3e-7)  # rotations are stored as quaternions of float32
    assert type(a.densities) is type(b.densities)
    for first, second in zip(astuple(a.densities), astuple(b.densities), strict=True):
        np.testing.assert_array_equal(first, second)


def test_a_map_comes_back_as_it_was(room_map: Map, tmp_path: Path) -> None:
    save_map(room_map, tmp_path / "room.rho")
    assert_same_map(load_map(tmp_path / "room.rho"), room_map)
    assert [path.name for path in tmp_path.iterdir()] == ["room.rho"]


def test_an_empty_map_comes_back(make_map, tmp_path: Path) -> None:
    save_map(make_map(features=0, views=0), tmp_path / "empty.rho")
    assert len(load_map(tmp_path / "empty.rho")) == 0


def test_every_array_of_a_map_is_stored() -> None:
    names = ("info", "landmarks", "descriptors", "views", "observations", "cloud", "room", "plan", "densities")
    assert tuple(field.name for field in fields(Map)) == names
    apart = {"views.pictures", *(f"observations.{name}" for name in ("views", "features", "pixels", "ranges_m"))}
    stored = {
        f"{name}.{column}"
        for name, table in (("landmarks", _LANDMARKS), ("descriptors", _DESCRIPTORS), ("views", _VIEWS))
        for column in table
    }
    tables = (MapLandmarks, MapDescriptors, MapViews, MapObservations)
    columns = {f"{name}.{column}" for name, one in zip(names[1:5], tables, strict=True) for column in one.columns()}
    assert columns == stored | apart


def test_colours_come_back_and_files_without_them_load(room_map: Map, tmp_path: Path) -> None:
    colours = np.random.default_rng(0).integers(0, 256, (len(room_map), 3), dtype=np.uint8)
    save_map(replace(room_map, landmarks=replace(room_map.landmarks, colours=colours)), tmp_path / "coloured.rho")
    save_map(room_map, tmp_path / "plain.rho")
    np.testing.assert_array_equal(load_map(tmp_path / "coloured.rho").landmarks.colours, colours)
    assert load_map(tmp_path / "plain.rho").landmarks.colours is None
    with pytest.raises(InvalidMap, match="colours"):
        save_map(replace(room_map, landmarks=replace(room_map.landmarks, colours=colours[:-1])), tmp_path / "short.rho")


def test_patches_come_back_and_files_without_them_load(room_map: Map, tmp_path: Path) -> None:
    patches = np.random.default_rng(0).normal(0, 0.03, (len(room_map), 3)).astype(np.float32)
    patches[3] = np.nan
    patches = storable_patches(patches)
    save_map(replace(room_map, landmarks=replace(room_map.landmarks, patches=patches)), tmp_path / "known.rho")
    save_map(room_map, tmp_path / "plain.rho")
    np.testing.assert_array_equal(load_map(tmp_path / "known.rho").landmarks.patches, patches)
    assert load_map(tmp_path / "plain.rho").landmarks.patches is None
    added_bytes = (tmp_path / "known.rho").stat().st_size - (tmp_path / "plain.rho").stat().st_size
    assert added_bytes < 3 * len(room_map) + 100  # and what names the array


def test_measured_ranges_come_back_and_files_without_them_load(whole_map: Map, tmp_path: Path) -> None:
    ranges_m = np.random.default_rng(0).uniform(1, 5, len(whole_map.observations)).astype(np.float32)
    ranges_m[::3] = np.nan
    measured = replace(whole_map, observations=replace(whole_map.observations, ranges_m=ranges_m))
    save_map(measured, tmp_path / "measured.rho")
    np.testing.assert_array_equal(load_map(tmp_path / "measured.rho").observations.ranges_m, ranges_m)
    save_map(whole_map, tmp_path / "plain.rho")
    assert load_map(tmp_path / "plain.rho").observations.ranges_m is None


@pytest.mark.parametrize("vector", [(0, 0, 0), (np.nan, 0, 1), (np.inf, 0, 0)])
def test_a_patch_that_is_none_is_refused(room_map: Map, tmp_path: Path, vector: tuple[float, ...]) -> None:
    patches = np.full((len(room_map), 3), 0.1, np.float32)
    patches[5] = vector
    for wrong in (patches, np.full((len(room_map) - 1, 3), 0.1, np.float32)):
        with pytest.raises(InvalidMap, match="patches"):
            save_map(replace(room_map, landmarks=replace(room_map.landmarks, patches=wrong)), tmp_path / "wrong.rho")


def test_how_uncertain_views_are_comes_back(room_map: Map, tmp_path: Path) -> None:
    factors = np.random.default_rng(2).normal(0, 0.01, (len(room_map.views), 6, 6))
    spread = (factors @ factors.transpose(0, 2, 1)).astype(np.float32)
    spread = (spread + spread.transpose(0, 2, 1)) / 2
    spread[1] = np.nan
    save_map(replace(room_map, views=replace(room_map.views, covariances=spread)), tmp_path / "room.rho")
    back = load_map(tmp_path / "room.rho")
    np.testing.assert_array_equal(back.views.covariances, spread)
    expected_m = np.sqrt(np.trace(spread[:, :3, :3], axis1=1, axis2=2))
    np.testing.assert_allclose(back.views.expected_errors_m, expected_m, rtol=1e-6)


def test_a_map_without_uncertainties_says_unknown(room_map: Map, tmp_path: Path) -> None:
    save_map(room_map, tmp_path / "room.rho")  # as every file of before was written
    back = load_map(tmp_path / "room.rho")
    assert back.views.covariances is None
    assert np.isnan(back.views.expected_errors_m).all()


@pytest.mark.parametrize(
    "spread",
    [
        np.zeros((3, 6, 6), np.float32),
        np.zeros((8, 6, 6), np.float64),
        np.tile(np.diag([1.0, 1, 1, 1, 1, -1]).astype(np.float32), (8, 1, 1)),
        np.full((8, 6, 6), np.inf, np.float32),
        np.triu(np.ones((8, 6, 6), np.float32)),
    ],
)
def test_covariances_of_views_that_are_none_are_refused(room_map: Map, spread: np.ndarray) -> None:
    with pytest.raises(InvalidMap, match="covariances"):
        map_to_bytes(replace(room_map, views=replace(room_map.views, covariances=spread)))


@pytest.fixture
def whole_map(make_map) -> Map:
    """With observations of two recordings, and with tensor densities: all that a file can hold."""
    map_: Map = make_map()
    rng = np.random.default_rng(4)
    camera = map_.info.camera
    sources = tuple(Source(name, name, camera) for name in ("first", "second"))
    pixels = rng.uniform([-0.5, -0.5], [639.4, 479.4], (len(map_.observations), 2))
    kept = unpacked_pixels(packed_pixels(pixels, camera), camera)
    landmarks = map_.landmarks.positions.astype(np.float64)
    places = (0.5 * landmarks).astype(np.float32).astype(np.float64)
    return replace(
        map_,
        info=replace(map_.info, density=DensityKind.TENSOR, sources=sources),
        views=replace(map_.views, sources=rng.integers(0, 2, len(map_.views)).astype(np.int32)),
        descriptors=replace(map_.descriptors, sources=rng.integers(0, 2, len(map_.descriptors)).astype(np.int32)),
        observations=replace(map_.observations, pixels=kept),
        densities=fit_tensors(landmarks, places, np.full(len(map_), 0.5), 2),
    )


def test_observations_and_fitted_densities_come_back(whole_map: Map, tmp_path: Path) -> None:
    save_map(whole_map, tmp_path / "whole.rho")
    assert_same_map(load_map(tmp_path / "whole.rho"), whole_map)


def test_what_is_saved_twice_is_the_same_file(whole_map: Map, tmp_path: Path) -> None:
    save_map(whole_map, tmp_path / "once.rho")
    once = load_map(tmp_path / "once.rho")
    save_map(once, tmp_path / "twice.rho")
    assert_same_map(load_map(tmp_path / "twice.rho"), once)


@pytest.mark.parametrize(("count", "kind"), [(256, np.uint8), (257, np.uint16), (65536, np.uint16), (65537, np.int32)])
def test_indices_take_no_more_bytes_than_they_need(make_map, tmp_path: Path, count: int, kind: type) -> None:
    path = tmp_path / "room.rho"
    small = make_map(features=20, views=3)
    longer = np.arange(count) % 20
    many = replace(
        small,
        landmarks=small.landmarks.take(longer),
        descriptors=replace(small.descriptors.take(np.arange(1)), features=np.array([count - 1], np.int32)),
    )
    save_map(many, path)
    assert _arrays(path)["descriptor_features"].dtype == kind
    assert_same_map(load_map(path), many)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("view_features", np.full(160, 255, np.uint8)),
        ("view_features", np.full(160, -1, np.int32)),
        ("view_features", np.full(160, 2**40, np.uint64)),
        ("view_features", np.zeros((160, 1), np.uint8)),
        ("descriptor_features", np.zeros(3, np.uint16)),
        ("view_offsets", np.array([0, 20, 10, 60, 80, 100, 120, 140, 160], np.uint8)),
        ("extras/tensor_degree", np.array(7, np.int32)),
        ("extras/tensor_coefficients", np.zeros((3, 6, 10, 27), np.float32)),
        ("extras/tensor_places", np.full((60, 3), np.nan, np.float32)),
        ("extras/tensor_features", np.array([[1]], np.int32)),
        ("extras/tensor_features", np.full(60, 60, np.int32)),
        ("extras/observation_pixels", np.zeros((3, 2), np.uint16)),
        ("extras/observation_pixels", np.zeros((3, 2), np.float32)),
        ("extras/observation_ranges", np.full(160, -1, np.float32)),
        ("extras/observation_ranges", np.ones(3, np.float32)),
        ("extras/observation_ranges", np.ones((160, 2), np.float32)),
        ("extras/view_sources", np.full(8, 2, np.int32)),
        ("extras/descriptor_sources", np.zeros(3, np.int32)),
        ("view_offsets", np.array([1, *[20] * 8], np.int32)),
        ("view_offsets", np.array([0, 20], np.int32)),
        ("view_offsets", np.zeros(0, np.int32)),
        ("view_offsets", np.array([0, 20, 10, 60, 80, 100, 120, 140, 160], np.int32)),
        ("view_poses", np.full((8, 7), 2.0, np.float32)),
        ("view_poses", np.full((8, 7), np.nan, np.float32)),
        ("covariances", np.zeros((60, 3, 3), np.float32)),
        ("landmarks", np.zeros((60, 3), np.float64)),
        ("view_covariances", np.zeros((8, 20), np.float32)),
        ("view_covariances", np.zeros((7, 21), np.float32)),
        ("extras/view_second_positions", np.zeros((7, 3), np.float32)),
    ],
)
def test_arrays_that_contradict_the_others_are_refused(
    whole_map: Map, tmp_path: Path, name: str, array: np.ndarray
) -> None:
    path = tmp_path / "whole.rho"
    save_map(whole_map, path)
    _rewrite(path, {name: array})
    with pytest.raises(InvalidMap):
        load_map(path)


@pytest.mark.parametrize("name", ["landmarks", "extras/tensor_radii"])
def test_a_missing_array_is_named(whole_map: Map, tmp_path: Path, name: str) -> None:
    path = tmp_path / "whole.rho"
    save_map(whole_map, path)
    _rewrite(path, {name: None})
    with pytest.raises(InvalidMap, match=f"has no {name.removeprefix('extras/')}"):
        load_map(path)


def test_arrays_of_later_versions_are_left_out(room_map: Map, tmp_path: Path) -> None:
    path = tmp_path / "room.rho"
    save_map(room_map, path)
    _rewrite(path, {"extras/later": np.zeros(3)})
    assert_same_map(load_map(path), room_map)


def test_a_report_with_numpy_numbers_and_nan_is_stored_as_json(room_map: Map, tmp_path: Path) -> None:
    report = MapReport(features=np.int64(3), views_per_feature_median=np.float32(2.5), landmark_sigma_p90_m=np.nan)
    save_map(replace(room_map, info=replace(room_map.info, report=report)), tmp_path / "room.rho")
    assert load_map(tmp_path / "room.rho").info.report == MapReport(features=3, views_per_feature_median=2.5)


@pytest.mark.parametrize(
    ("broken", "where"),
    [
        ({"report": {"held_out": 4}}, "report.held_out"),
        ({"report": {"coverage": {"median": 3}}}, "report.coverage.share_sufficient"),
        ({"report": [1]}, "report"),
        ({"version": "first"}, "version"),
        ({"density": "fog"}, "density"),
        ({"sources": [{"frames": 3}]}, "sources.0.name"),
        ({"waypoints": [{"name": "W1", "position": [1.0, 2.0]}]}, "waypoints.0.position"),
        ({"camera": {"width": 0, "height": 0, "fx": 1, "fy": 1, "cx": 0, "cy": 0}}, "image size"),
        ({"camera": None}, "camera"),
    ],
)
def test_a_description_that_is_broken_is_refused_and_says_where(
    room_map: Map, broken: dict[str, object], where: str
) -> None:
    description = json.loads(info_to_json(room_map.info))
    with pytest.raises(InvalidMap, match=where) as caught:
        info_from_json(json.dumps(description | broken))
    assert "\n" not in str(caught.value)


def test_the_map_of_a_kitchen_is_small(make_map) -> None:
    assert len(map_to_bytes(make_map(features=4000, views=150))) < 1_500_000


@_SHARED_FOLDER
@given(data=st.data())
def test_a_flipped_byte_is_refused_or_harmless(room_map: Map, tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(map_to_bytes(room_map))
    header = 8 + struct.unpack("<Q", content[:8])[0]
    anywhere = st.one_of(st.integers(0, header - 1), st.integers(header, len(content) - 1))
    position, value = data.draw(anywhere), data.draw(st.integers(1, 255))
    content[position] ^= value
    path = tmp_path / "flipped.rho"
    path.write_bytes(content)
    if position >= header:
        with pytest.raises(InvalidMap):
            load_map(path)
        return
    try:
        loaded = load_map(path)
    except InvalidMap:
        return
    assert_same_map(loaded, room_map)  # white space of the header


@_SHARED_FOLDER
@given(fraction=st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_refused(room_map: Map, tmp_path: Path, fraction: float) -> None:
    content = map_to_bytes(room_map)
    path = tmp_path / "cut.rho"
    path.write_bytes(content[: int(fraction * len(content))])
    with pytest.raises(InvalidMap):
        load_map(path)


@_SHARED_FOLDER
@given(content=st.binary(max_size=200))
def test_foreign_bytes_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "foreign.rho"
    path.write_bytes(content)
    with pytest.raises(InvalidMap):
        load_map(path)


def test_another_programs_safetensors_file_is_refused(tmp_path: Path) -> None:
    save_file({"weight": np.zeros(3, np.float32)}, tmp_path / "model.rho")
    with pytest.raises(InvalidMap, match="not a rholoc map"):
        load_map(tmp_path / "model.rho")


def test_a_header_that_claims_a_huge_length_is_refused(tmp_path: Path) -> None:
    (tmp_path / "huge.rho").write_bytes(struct.pack("<Q", 2**62) + b"{}")
    with pytest.raises(InvalidMap):
        load_map(tmp_path / "huge.rho")


def test_another_version_is_refused_with_advice(room_map: Map, tmp_path: Path) -> None:
    path = tmp_path / "later.rho"
    save_map(room_map, path)
    for version in ("1", "3"):
        _rewrite(path, format_version=version)
        with pytest.raises(InvalidMap, match=f"version {version}") as caught:
            load_map(path)
        assert "Update" in caught.value.hint


def test_a_changed_description_is_noticed(room_map: Map, tmp_path: Path) -> None:
    path = tmp_path / "changed.rho"
    save_map(room_map, path)
    info = json.loads(_metadata(path)["info"]) | {"metric": False}
    _rewrite(path, info=json.dumps(info))
    with pytest.raises(InvalidMap, match="checksum"):
        load_map(path)


def test_a_missing_file_is_an_unknown_map(tmp_path: Path) -> None:
    with pytest.raises(UnknownMap):
        load_map(tmp_path / "none.rho")


def test_a_missing_folder_is_reported(room_map: Map, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="cannot be written"):
        save_map(room_map, tmp_path / "none" / "room.rho")


@pytest.mark.parametrize("after_bytes", [0, 1000])
@pytest.mark.parametrize("cause", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_keeps_the_old_map(
    room_map: Map, make_map, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after_bytes: int, cause: int
) -> None:
    path = tmp_path / "room.rho"
    save_map(room_map, path)
    write, room = os.write, [after_bytes]

    def write_until_full(descriptor: int, data: memoryview) -> int:
        if room[0] == 0:
            raise OSError(cause, os.strerror(cause))
        written = write(descriptor, data[: room[0]])
        room[0] -= written
        return written

    monkeypatch.setattr(os, "write", write_until_full)
    with pytest.raises(StorageFull):
        save_map(make_map(seed=2), path)
    monkeypatch.undo()
    assert_same_map(load_map(path), room_map)
    assert [file.name for file in tmp_path.iterdir()] == ["room.rho"]


def test_a_map_that_was_loaded_survives_its_file(room_map: Map, tmp_path: Path) -> None:
    path = tmp_path / "room.rho"
    save_map(room_map, path)
    loaded = load_map(path)
    path.write_bytes(b"")  # overwritten in place, as `cp` does
    assert_same_map(loaded, room_map)


def test_errors_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "foreign.rho").write_bytes(b"\x00" * 64)
    with pytest.raises(RholocError) as caught:
        load_map(tmp_path / "foreign.rho")
    assert "\n" not in str(caught.value)


def _metadata(path: Path) -> dict[str, str]:
    with safe_open(path, framework="numpy") as file:
        return file.metadata()


def _arrays(path: Path) -> dict[str, np.ndarray]:
    with safe_open(path, framework="numpy") as file:
        return {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118


def _rewrite(path: Path, changed: dict[str, np.ndarray | None] | None = None, **metadata: str) -> None:
    """The file with other arrays (None leaves one out) and a checksum that fits, or with other metadata."""
    kept, arrays = _metadata(path), _arrays(path)
    if changed is not None:
        arrays = {name: array for name, array in (arrays | changed).items() if array is not None}
        kept["checksum"] = _checksum(kept["info"], arrays)
    save_file(arrays, path, kept | metadata)


def test_a_header_of_endless_arrays_is_refused_before_it_is_parsed(tmp_path, monkeypatch):
    monkeypatch.setattr("rholoc.maps.formats.rho_file.safe_open", None)
    empty = b'"t%d":{"dtype":"U8","shape":[0],"data_offsets":[0,0]}'
    header = b"{" + b",".join(empty % number for number in range(300_000)) + b"}"
    for content in (header, b'{"__metadata__":{"info":"' + b"x" * 2**26 + b'"}}'):
        path = tmp_path / "endless.rho"
        path.write_bytes(len(content).to_bytes(8, "little") + content)
        begun = time.process_time()
        for read in (load_map, load_outline):
            with pytest.raises(InvalidMap, match="header"):
                read(path)
        assert time.process_time() - begun < 1.0


def test_a_text_that_does_not_end_costs_nothing(tmp_path):
    path = tmp_path / "open.rho"
    content = b'{"__metadata__":{"info":"' + b"\\\\x" * 2**20
    path.write_bytes(len(content).to_bytes(8, "little") + content)
    with pytest.raises(InvalidMap):
        load_map(path)
