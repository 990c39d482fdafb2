"""A part of a map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rholoc.maps import Map, part_of, validate_map


def test_a_part_has_its_views_and_what_they_saw(room_map: Map) -> None:
    views = np.array([1, 2, 6])
    patches = np.random.default_rng(0).normal(size=(len(room_map), 3)).astype(np.float32)
    part = part_of(replace(room_map, patches=patches), views)
    validate_map(part.map)
    seen = np.isin(room_map.observation_views, views)
    np.testing.assert_array_equal(part.features, np.unique(room_map.observation_features[seen]))
    np.testing.assert_array_equal(part.map.landmarks, room_map.landmarks[part.features])
    np.testing.assert_array_equal(part.map.patches, patches[part.features])
    np.testing.assert_array_equal(part.map.T_map_camera, room_map.T_map_camera[views])
    np.testing.assert_array_equal(part.features[part.map.observation_features], room_map.observation_features[seen])
    np.testing.assert_array_equal(views[part.map.observation_views], room_map.observation_views[seen])
    described = np.isin(room_map.descriptor_features, part.features)
    np.testing.assert_array_equal(part.map.descriptors, room_map.descriptors[described])
    np.testing.assert_array_equal(part.features[part.map.descriptor_features], room_map.descriptor_features[described])


def test_the_part_of_all_views_is_the_map(room_map: Map) -> None:
    part = part_of(room_map, np.arange(len(room_map.view_times)))
    assert len(part.map) == len(np.unique(room_map.observation_features))
    np.testing.assert_array_equal(part.map.observation_views, room_map.observation_views)
