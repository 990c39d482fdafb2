"""Rows taken of a map's tables, and tables joined: every column goes with its rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rholoc.maps import Map, MapViews
from rholoc.maps.map_tables import UNKNOWN_GREY, MapTable
from same_maps import assert_same_tables

TABLES = ("landmarks", "descriptors", "views", "observations")


def table_of(map_: Map, name: str) -> MapTable:
    table: MapTable = getattr(map_, name)
    return table


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
