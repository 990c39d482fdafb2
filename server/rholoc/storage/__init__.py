"""Objects in a folder or a shared storage, the database, and the catalogue that servers share."""

from rholoc.storage.objects import MissingObject, ObjectStorage
from rholoc.storage.shared import ASKERS, CAMERAS, KEYS, SITES, SharedStorage

__all__ = ["ASKERS", "CAMERAS", "KEYS", "SITES", "MissingObject", "ObjectStorage", "SharedStorage"]
