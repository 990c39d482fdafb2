"""The map that is shipped: it loads, and its report is understood."""

from pathlib import Path

import numpy as np

from rholoc.maps import load_map, memory_of, save_map, trust_of

MAPS = Path(__file__).parents[2] / "maps"


def test_the_shipped_map_is_read_with_all_that_it_reports() -> None:
    map_ = load_map(MAPS / "testsite.rho")
    (source,) = map_.info.sources
    assert source.camera == map_.info.camera
    assert source.views == len(map_.views)
    report = map_.info.report
    assert report.features == len(map_)
    assert report.held_out.frames == report.held_out.localized == 4
    assert (report.coverage, report.coaching) == (None, ())
    assert trust_of(map_.info).trusted
    assert memory_of(map_) is not None


def test_the_shipped_map_is_written_as_it_was(tmp_path: Path) -> None:
    map_ = load_map(MAPS / "testsite.rho")
    save_map(map_, tmp_path / "again.rho")
    again = load_map(tmp_path / "again.rho")
    assert again.info == map_.info
    np.testing.assert_array_equal(again.observations.pixels, map_.observations.pixels)
    np.testing.assert_array_equal(again.landmarks.positions, map_.landmarks.positions)
    np.testing.assert_allclose(again.views.T_map_camera, map_.views.T_map_camera, rtol=0, atol=3e-7)
