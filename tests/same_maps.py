"""Maps held against each other, column by column."""

import numpy as np

from rholoc.maps import Map


def assert_same_tables(a: Map, b: Map, pose_tolerance: float = 0.0) -> None:
    """The tables of both have the same columns, of the same types; poses may be off by ``pose_tolerance``."""
    for name in ("landmarks", "descriptors", "views", "observations"):
        first, second = getattr(a, name), getattr(b, name)
        assert type(first) is type(second)
        for column in first.columns():
            one, other = getattr(first, column), getattr(second, column)
            if isinstance(one, np.ndarray):
                assert one.dtype == other.dtype, f"{name}.{column}"
                atol = pose_tolerance if column == "T_map_camera" else 0
                np.testing.assert_allclose(one, other, rtol=0, atol=atol, err_msg=f"{name}.{column}")
            else:
                assert one == other, f"{name}.{column}"
