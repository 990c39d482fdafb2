"""National grids and heights above the sea, against pyproj."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyproj
import pytest
from pyproj import Transformer

from rholoc.errors import InvalidInput, NotInstalled
from rholoc.geometry import FloatArray
from rholoc.geometry.earth import enu_of, places_in
from rholoc.maps import SiteOnEarth

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
