"""Places on Earth: known distances, and round trips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

from rholoc.geometry.earth import EarthPlace, R_enu_enu, enu_of, place_at

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
