"""A part of a map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rholoc.maps import Map, part_of, validate_map


def test_a_part_has_its_views_and_what_they_saw(room_map: Map) -> None:
    views = np.array([1, 2, 6])
    patches = np.random.default_rng(0).normal(size=(len(room_map), 3)).astype(np.float32)
    part = part_of(replace(room_map, landmarks=replace(room_map.landmarks, patches=patches)), views)
    validate_map(part.map)
    seen = np.isin(room_map.observations.views, views)
    np.testing.assert_array_equal(part.features, np.unique(room_map.observations.features[seen]))
    np.testing.assert_array_equal(part.map.landmarks.positions, room_map.landmarks.positions[part.features])
    np.testing.assert_array_equal(part.map.landmarks.patches, patches[part.features])
    np.testing.assert_array_equal(part.map.views.T_map_camera, room_map.views.T_map_camera[views])
    np.testing.assert_array_equal(part.features[part.map.observations.features], room_map.observations.features[seen])
    np.testing.assert_array_equal(views[part.map.observations.views], room_map.observations.views[seen])
    described = np.isin(room_map.descriptors.features, part.features)
    np.testing.assert_array_equal(part.map.descriptors.values, room_map.descriptors.values[described])
    np.testing.assert_array_equal(
        part.features[part.map.descriptors.features], room_map.descriptors.features[described]
    )


def test_the_part_of_all_views_is_the_map(room_map: Map) -> None:
    part = part_of(room_map, np.arange(len(room_map.views)))
    assert len(part.map) == len(np.unique(room_map.observations.features))
    np.testing.assert_array_equal(part.map.observations.views, room_map.observations.views)
