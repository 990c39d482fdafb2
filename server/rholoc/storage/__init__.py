"""Objects in a folder or a shared storage, the database, and the catalogue that servers share."""

from rholoc.storage.objects import ObjectStorage

__all__ = ["ObjectStorage"]
