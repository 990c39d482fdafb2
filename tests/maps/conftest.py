"""A synthetic map of a room."""

from synthetic_map import make_map as make_map
from synthetic_map import room_map as room_map
