"""Stores that several processes share, and a small map."""

from shared_stores import open_storage as open_storage
from shared_stores import storage_url as storage_url
from synthetic_map import room_map as room_map
