"""Named points and areas as GeoJSON, and floor plans of other programs: round trips, other readers, damaged files."""

import io
import json
import math
import os
import zipfile

import numpy as np
import pyproj
import pytest
from geojson_pydantic import FeatureCollection
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from rholoc.errors import InvalidInput
from rholoc.maps import MapNames, NamedArea, NamedPoint, SiteOnEarth, check_names
from rholoc.maps.formats.geojson import names_from_geojson, names_to_geojson
from rholoc.maps.formats.plan_files import PlanPlacement, level_of_archive, packed_yaml, plan_of_archive, read_plan

EARTH = SiteOnEarth(52.52, 13.405, 74.0, 33.0)
NAMES = MapNames(
    (NamedPoint("Tür", (1.25, -3.5, 0.5), "door", {"width_m": 0.9, "fire": True, "note": None}),),
    (NamedArea("Küche", ((0.0, 0.0), (0.0, 3.0), (4.0, 3.0), (4.0, 0.0)), "room", {"seats": 4}),),
)
LEVEL = "11111111-1111-4111-8111-111111111111"
OTHER = "22222222-2222-4222-8222-222222222222"
RING = [[13.405, 52.52], [13.4052, 52.52], [13.4052, 52.5201], [13.405, 52.5201], [13.405, 52.52]]


def places(names: MapNames) -> list[tuple[object, ...]]:
    """Names as they compare: outlines from their westernmost corner, counter-clockwise."""
    found: list[tuple[object, ...]] = [
        (one.name, one.kind, dict(one.fields), *np.round(one.position, 5).tolist()) for one in names.points
    ]
    for area in names.areas:
        corners = sorted(tuple(np.round(corner, 5).tolist()) for corner in area.outline)
        found.append((area.name, area.kind, dict(area.fields), *corners))
    return found


def imdf(**files: list[dict]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("manifest.json", json.dumps({"version": "1.0.0", "language": "en"}))
        for name, features in files.items():
            archive.writestr(f"{name}.geojson", json.dumps({"type": "FeatureCollection", "features": features}))
    return packed.getvalue()


def feature(kind: str, key: str, geometry: dict | None, **properties: object) -> dict:
    return {"id": key, "type": "Feature", "feature_type": kind, "geometry": geometry, "properties": properties}


POLYGON = {"type": "Polygon", "coordinates": [RING]}
BUILDING = imdf(
    level=[
        feature("level", LEVEL, POLYGON, name={"en": "Ground floor"}, short_name={"en": "G"}, ordinal=0),
        feature("level", OTHER, POLYGON, name={"en": "First floor"}, short_name={"en": "1"}, ordinal=1),
    ],
    unit=[
        feature("unit", "u1", POLYGON, name={"en": "Hall"}, category="room", level_id=LEVEL),
        feature("unit", "u2", POLYGON, name=None, category="nonpublic", level_id=LEVEL),
        feature("unit", "u3", POLYGON, name={"en": "Attic"}, category="room", level_id=OTHER),
    ],
    opening=[
        feature("opening", "o1", {"type": "LineString", "coordinates": RING[:2]}, name=None, level_id=LEVEL),
    ],
    amenity=[
        feature("amenity", "a1", {"type": "Point", "coordinates": RING[0]}, name={"de": "Lift"}, level_id=LEVEL),
    ],
)


@pytest.mark.parametrize("earth", [None, EARTH], ids=["map", "earth"])
def test_names_come_back_from_geojson_that_a_validator_accepts(earth):
    document = names_to_geojson(NAMES, earth)
    FeatureCollection.model_validate(document)
    ring = np.array(document["features"][1]["geometry"]["coordinates"][0])
    assert np.sum(ring[:-1, 0] * ring[1:, 1] - ring[1:, 0] * ring[:-1, 1]) > 0  # counter-clockwise, as RFC 7946 wants
    assert (document.get("frame") == "map") == (earth is None)
    assert places(names_from_geojson(json.dumps(document).encode(), earth)) == places(NAMES)


@pytest.mark.parametrize("kind", ["", "door"])
def test_a_field_called_category_comes_back_from_geojson(kind):
    names = MapNames((NamedPoint("a", (1.0, 2.0, 3.0), kind, {"category": "B"}),))
    assert places(names_from_geojson(json.dumps(names_to_geojson(names, None)).encode(), None)) == places(names)


@given(
    st.floats(-80, 80),
    st.floats(-179, 179),
    st.floats(0, 360),
    st.lists(st.tuples(*[st.floats(-300, 300)] * 3), min_size=1, max_size=5),
)
def test_points_lie_on_earth_where_pyproj_says(latitude, longitude, heading, positions):
    earth = SiteOnEarth(latitude, longitude, 20.0, heading)
    names = MapNames(tuple(NamedPoint(str(i), position) for i, position in enumerate(positions)))
    found = names_to_geojson(names, earth)["features"]
    turn = math.radians(heading)
    local = pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={latitude} +lon_0={longitude} +h_0=20"
    )
    for (x, y, z), one in zip(positions, found, strict=True):
        enu = local.transform(*one["geometry"]["coordinates"])
        expected = (x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn), z)
        np.testing.assert_allclose(enu, expected, atol=1e-4)


@pytest.mark.parametrize(
    "document",
    [
        b"{",
        b"[]",
        b"\xff",
        b'{"type": "FeatureCollection"}',
        b'{"type": "FeatureCollection", "features": [3]}',
        b'{"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": null, "properties": null}]}',
        b'{"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": {"type": "Point", "coordinates": '
        b'[NaN, 2]}, "properties": {"name": "a"}}]}',
        b"[" * 100_000,
    ],
)
def test_damaged_geojson_is_refused_in_a_line(document):
    with pytest.raises(InvalidInput) as found:
        names_from_geojson(document, EARTH)
    assert "\n" not in found.value.message


@pytest.mark.parametrize(
    ("geometry", "properties"),
    [
        ({"type": "Point", "coordinates": [200.0, 50.0]}, {"name": "a"}),
        ({"type": "Point", "coordinates": [13.0]}, {"name": "a"}),
        ({"type": "Point", "coordinates": ["x", 1]}, {"name": "a"}),
        ({"type": "Point", "coordinates": [80.0, 50.0]}, {"name": "a"}),
        ({"type": "Point", "coordinates": [10**400, 50.0]}, {"name": "a"}),
        ({"type": "Point", "coordinates": RING[0]}, {"name": "a", "note": 10**400}),
        ({"type": "Point", "coordinates": RING[0]}, {"name": "a", "note": "\ud800"}),
        ({"type": "Point", "coordinates": RING[0]}, {"name": "a", "kind": "\ud800"}),
        ({"type": "LineString", "coordinates": RING}, {"name": "a"}),
        ({"type": "Polygon", "coordinates": [RING, RING]}, {"name": "a"}),
        ({"type": "Polygon", "coordinates": [RING[:2]]}, {"name": "a"}),
        ({"type": "Point", "coordinates": RING[0]}, {}),
        ({"type": "Point", "coordinates": RING[0]}, {"name": "a", "note": "x" * 1001}),
        ({"type": "Point", "coordinates": RING[0]}, {"name": "a", **{str(i): i for i in range(51)}}),
    ],
)
def test_places_that_a_map_cannot_keep_are_refused(geometry, properties):
    document = {"type": "Feature", "geometry": geometry, "properties": properties}
    with pytest.raises(InvalidInput):
        names_from_geojson(json.dumps(document).encode(), EARTH)


def test_longitude_and_latitude_need_a_place_on_earth():
    document = {"type": "Feature", "geometry": {"type": "Point", "coordinates": RING[0]}, "properties": {"name": "a"}}
    with pytest.raises(InvalidInput, match="pose on Earth is unknown"):
        names_from_geojson(json.dumps(document).encode(), None)


@pytest.mark.parametrize("fields", [{"name": "x"}, {"": 1}, {"a\nb": 1}, {"x": math.inf}])
def test_fields_that_cannot_be_kept_are_refused(fields):
    with pytest.raises(InvalidInput):
        check_names(MapNames((NamedPoint("a", (0.0, 0.0, 0.0), fields=fields),)))


@pytest.mark.parametrize("level", ["G", "Ground floor", "0", LEVEL])
def test_a_level_of_imdf_is_a_plan_and_names(level):
    content, plan = plan_of_archive(BUILDING, level)
    document = FeatureCollection.model_validate_json(content)
    assert [one.id for one in document.features] == [LEVEL, "u1", "u2", "o1"]
    assert (plan.media_type, plan.corner, plan.m_per_unit) == ("application/geo+json", (0.0, 0.0), 1.0)
    names = names_from_geojson(level_of_archive(BUILDING, level), EARTH)
    assert [(one.name, one.kind) for one in names.areas] == [("Hall", "room")]
    assert [one.name for one in names.points] == ["Lift"]
    np.testing.assert_allclose(names.points[0].position, 0, atol=1e-6)


def test_a_plan_of_geojson_lies_where_its_coordinates_say():
    content, plan = read_plan(BUILDING, None, "G", PlanPlacement(), EARTH)
    np.testing.assert_allclose([*plan.corner, plan.turn_deg], [0, 0, 33], atol=1e-6)
    _, moved = read_plan(content, "application/geo+json", None, PlanPlacement(x=2.0), EARTH)
    assert (moved.corner, moved.turn_deg) == ((2.0, 0.0), 0.0)
    for empty in (b'{"type": "FeatureCollection", "features": []}', b'{"type": "Point", "coordinates": [1e400, 2]}'):
        with pytest.raises(InvalidInput, match="longitude"):
            read_plan(empty, None, None, PlanPlacement(), EARTH)


@pytest.mark.parametrize(("level", "names"), [(None, "G, 1"), ("Roof", "G, 1")])
def test_the_levels_are_named_where_one_has_to_be_chosen(level, names):
    with pytest.raises(InvalidInput, match=r"level") as found:
        plan_of_archive(BUILDING, level)
    assert names in found.value.hint


@pytest.mark.parametrize("negate", [0, 1])
def test_a_map_server_s_yaml_brings_its_picture_and_place(tmp_path, negate):
    pixels = np.full((30, 40), 254, np.uint8)
    pixels[0] = 0  # a wall at the top
    Image.fromarray(255 - pixels if negate else pixels).save(tmp_path / "hall.pgm")
    (tmp_path / "hall.yaml").write_text(
        f"image: hall.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1.5, 2.0, 0.5]\nnegate: {negate}\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    content, plan = plan_of_archive(packed_yaml(tmp_path / "hall.yaml"), None)
    np.testing.assert_array_equal(np.array(Image.open(io.BytesIO(content))), pixels)
    assert (plan.media_type, plan.corner, plan.m_per_unit) == ("image/png", (-1.5, 2.0), 0.05)
    assert plan.turn_deg == pytest.approx(math.degrees(0.5))


def test_an_archive_by_macos_is_read_without_its_resource_forks():
    picture = io.BytesIO()
    Image.new("L", (4, 3)).save(picture, "PNG")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("._hall.yaml", b"\0\5\x16\7")
        archive.writestr("__MACOSX/hall.yaml", b"\0\5\x16\7")
        archive.writestr("__MACOSX/hall.png", b"\0\5\x16\7")
        archive.writestr("./hall.yaml", "image: hall.png\nresolution: 0.05\norigin: [0, 0, 0]\n")
        archive.writestr("hall.png", picture.getvalue())
    content, _ = plan_of_archive(packed.getvalue(), None)
    assert Image.open(io.BytesIO(content)).size == (4, 3)


def test_a_picture_older_than_zip_files_is_packed(tmp_path):
    Image.new("L", (4, 3)).save(tmp_path / "hall.pgm")
    os.utime(tmp_path / "hall.pgm", (0, 0))
    (tmp_path / "hall.yaml").write_text("image: hall.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")
    content, _ = plan_of_archive(packed_yaml(tmp_path / "hall.yaml"), None)
    assert Image.open(io.BytesIO(content)).size == (4, 3)


@pytest.mark.parametrize(
    "yaml",
    ["", "[", "image: hall.pgm", "image: x.pgm\nresolution: .nan\norigin: [0, 0, 0]", "a: &a [*a]", "x: " + "[" * 1000],
)
def test_a_yaml_that_is_none_is_refused(tmp_path, yaml):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("hall.yaml", yaml)
        archive.writestr("hall.pgm", b"P5\n1 1\n255\n\0")
    with pytest.raises(InvalidInput):
        plan_of_archive(packed.getvalue(), None)


def test_archives_that_are_damaged_or_too_large_are_refused():
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("level.geojson", b"0" * (2**26 + 1))
    crowd = imdf(**{f"part{i}": [] for i in range(1001)})
    broken = bytearray(BUILDING)
    broken[60:200] = b"\0" * 140
    for content in (b"PK", b"no archive", bytes(broken), crowd, imdf(unit=[])):
        with pytest.raises(InvalidInput):
            plan_of_archive(content, "G")
    with pytest.raises(InvalidInput, match="more than 64 MB"):
        plan_of_archive(bomb.getvalue(), "G")
