"""Where a service keeps what it holds: the database, and object storage for those that share it."""

from rholoc.storage.objects import MissingObject, ObjectStorage
from rholoc.storage.shared import ASKERS, CAMERAS, KEYS, SITES, SharedStorage

__all__ = ["ASKERS", "CAMERAS", "KEYS", "SITES", "MissingObject", "ObjectStorage", "SharedStorage"]
