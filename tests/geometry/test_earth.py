"""Places on Earth: known distances, and round trips; national grids and heights above the sea, against pyproj."""

import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

from rholoc.errors import InvalidInput, NotInstalled
from rholoc.geometry import FloatArray
from rholoc.geometry.earth import EarthPlace, R_enu_enu, enu_of, place_at, places_in
from rholoc.maps import SiteOnEarth

BERLIN = EarthPlace(52.520008, 13.404954, 74.0)


@given(
    st.floats(-90, 90), st.floats(-180, 180), st.floats(-100, 5000),
    st.tuples(*[st.floats(-5000, 5000)] * 3),
)  # fmt: skip
def test_there_and_back(latitude: float, longitude: float, height: float, enu: tuple[float, ...]) -> None:
    origin = EarthPlace(latitude, longitude, height)
    back = enu_of(place_at(np.array(enu), origin), origin)
    assert np.allclose(back, enu, atol=1e-5)


@pytest.mark.parametrize(
    ("origin", "latitude_m", "longitude_m"),
    [  # lengths of a degree on the ellipsoid of WGS 84, by its definition
        (EarthPlace(0.0, 0.0), 110_574.3, 111_319.5),
        (EarthPlace(45.0, 10.0), 111_131.7, 78_846.8),
        (EarthPlace(60.0, 24.0), 111_412.2, 55_800.0),
    ],
)
def test_a_degree_is_as_long_as_it_is(origin: EarthPlace, latitude_m: float, longitude_m: float) -> None:
    step = 1e-4
    north = (
        enu_of(EarthPlace(origin.latitude_deg + step / 2, origin.longitude_deg), origin)[1]
        - (enu_of(EarthPlace(origin.latitude_deg - step / 2, origin.longitude_deg), origin)[1])
    )
    east = enu_of(EarthPlace(origin.latitude_deg, origin.longitude_deg + step), origin)[0]
    assert north / step == pytest.approx(latitude_m, abs=1.5)
    assert east / step == pytest.approx(longitude_m, abs=1.5)


def test_up_is_up() -> None:
    above = place_at(np.array([0.0, 0.0, 12.5]), BERLIN)
    assert above.height_m == pytest.approx(86.5, abs=1e-6)
    assert (above.latitude_deg, above.longitude_deg) == pytest.approx((52.520008, 13.404954), abs=1e-9)


@given(
    st.floats(-89, 89), st.floats(-180, 180), st.floats(-100, 5000),
    st.tuples(*[st.floats(-5000, 5000)] * 3),
)  # fmt: skip
def test_it_is_where_pyproj_says(latitude: float, longitude: float, height: float, enu: tuple[float, ...]) -> None:
    origin = EarthPlace(latitude, longitude, height)
    there = place_at(np.array(enu), origin)
    pipeline = f"+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 +lat_0={latitude} "
    topocentric = Transformer.from_pipeline(f"{pipeline}+lon_0={longitude} +h_0={height}")
    theirs = topocentric.transform(there.longitude_deg, there.latitude_deg, there.height_m)
    assert np.allclose(theirs, enu, atol=1e-3)


def test_axes_are_those_of_pyproj_at_another_place() -> None:
    origin, place = BERLIN, EarthPlace(52.6, 13.6, 30.0)
    axes = []
    for lat, lon, h in ((one.latitude_deg, one.longitude_deg, one.height_m) for one in (origin, place)):
        pipeline = f"+proj=topocentric +ellps=WGS84 +lat_0={lat} +lon_0={lon} +h_0={h}"
        ecef = Transformer.from_pipeline(pipeline)
        zero = np.array(ecef.transform(0.0, 0.0, 0.0, direction="INVERSE"))
        axes.append(
            np.column_stack([np.array(ecef.transform(*one, direction="INVERSE")) - zero for one in np.eye(3).tolist()])
        )
    np.testing.assert_allclose(R_enu_enu(place, origin), axes[1].T @ axes[0], atol=1e-8)


SEA = "EPSG:32633+5773"  # UTM zone 33, heights of EGM96
POINT = (391779.24, 5820072.41, 36.2)


@pytest.fixture
def geoid(tmp_path: Path) -> Iterator[FloatArray]:
    """Undulations (181, 361) [m] of a made-up geoid, south to north and west to east, that PROJ takes for EGM96."""
    undulations = 30 + 0.1 * np.arange(181.0)[:, None] + 0.02 * np.arange(361.0)
    header = struct.pack(">4d2i", -90, -180, 1, 1, *undulations.shape)
    (tmp_path / "egm96_15.gtx").write_bytes(header + undulations.astype(">f4").tobytes())
    before = pyproj.datadir.get_data_dir()
    pyproj.datadir.append_data_dir(str(tmp_path))
    yield undulations
    pyproj.datadir.set_data_dir(before)


@pytest.mark.parametrize(
    ("crs", "origin"),
    [
        ("EPSG:25833", (391779.24, 5820072.41, 74.0)),  # ETRS89, UTM
        ("EPSG:2056", (2683000.0, 1248000.0, 440.0)),  # Switzerland, on another ellipsoid
        ("EPSG:2154", (652000.0, 6862000.0, 80.0)),  # France
        ("epsg:4326", (13.405, 52.52, 74.0)),
    ],
)
def test_a_map_anchored_in_a_grid_goes_there_and_back_to_a_millimetre(crs: str, origin: tuple[float, ...]) -> None:
    step = 2e-4 if crs == "epsg:4326" else 15.0
    offsets = np.random.default_rng(7).uniform(-1, 1, (6, 3)) * [step, step, 4]
    given = np.array(origin) + offsets
    places = places_in(crs, given)
    truth = SiteOnEarth(places[0].latitude_deg, places[0].longitude_deg, places[0].height_m, 33.0)
    points = np.array([truth.R_enu_site.T @ enu_of(place, truth.origin) for place in places])
    anchored, missed_m = SiteOnEarth.through(points, places)
    assert missed_m < 1e-3
    back = Transformer.from_crs(4979, pyproj.CRS(crs).to_3d(), always_xy=True)
    found = [anchored.place(point) for point in points]
    ends = [(place.longitude_deg, place.latitude_deg, place.height_m) for place in found]
    easting, northing, _ = back.transform(*np.transpose(ends))
    tolerance = 1e-8 if crs == "epsg:4326" else 1e-3
    np.testing.assert_allclose(np.transpose([easting, northing]), given[:, :2], rtol=0, atol=tolerance)
    np.testing.assert_allclose([place.height_m for place in found], given[:, 2], rtol=0, atol=1e-3)


def test_heights_above_the_sea_become_heights_above_the_ellipsoid(geoid: FloatArray) -> None:
    (place,) = places_in(SEA, np.array([POINT]))
    row, column = place.latitude_deg + 90, place.longitude_deg + 180
    assert place.height_m == pytest.approx(POINT[2] + 30 + 0.1 * row + 0.02 * column, abs=1e-3)
    back = Transformer.from_crs("EPSG:4979", SEA, always_xy=True)
    found = back.transform(place.longitude_deg, place.latitude_deg, place.height_m)
    np.testing.assert_allclose(found, POINT, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("crs", "point", "words"),
    [
        (SEA, POINT, "needs PROJ's file us_nga_egm96_15.tif, which is not on this machine. pyproj sync"),
        ("EPSG:25833+7837", POINT, "de_bkg_gcg2016.tif"),
        ("EPSG:27700", (530000, 180000, 50), "uk_os_OSTN15_NTv2_OSGBtoETRS.tif"),  # a shift that no formula gives
        ("EPSG:5773", POINT, "no grid"),
        ("EPSG:4978", POINT, "no grid"),
        ("EPSG:999999", POINT, "no grid"),
        ("/etc/passwd", POINT, "no grid that PROJ knows. Give a grid's EPSG code"),
        ("EPSG:25833", (52.52, 13.405, 74), "knows no way"),
        ("EPSG:25833", (1e12, 1e12, 0), "outside"),
    ],
)
def test_what_cannot_be_converted_is_said_and_not_guessed(crs: str, point: tuple[float, ...], words: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        places_in(crs, np.array([point]))
    assert words in f"{refused.value.message} {refused.value.hint}"


def test_without_pyproj_one_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(NotInstalled) as refused:
        places_in("EPSG:25833", np.array([POINT]))
    assert refused.value.hint == "pip install 'rholoc[grids]'."
