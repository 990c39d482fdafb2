"""A server's stored objects: maps, recordings, queries, cameras and sites.

Names are imported when they are first asked for: cameras are kept where nothing of a server is installed, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rholoc.lazy import loader

if TYPE_CHECKING:
    from rholoc.library.cameras import CameraLibrary, CameraProfile, check_camera_name
    from rholoc.library.data_import import ImportedData, import_data
    from rholoc.library.folder_documents import Documents, FolderDocuments
    from rholoc.library.maps import MapLibrary
    from rholoc.library.queries import KeptLimits, KeptQueries, QueryStore
    from rholoc.library.recording_notes import (
        WAYPOINTS_FILE,
        RecordedWaypoint,
        RecordingNotes,
        corrected_waypoints,
        read_notes,
        read_thumbnail,
        waypoints_file,
    )
    from rholoc.library.recordings import PendingRecording, RecordingEntry, RecordingStore
    from rholoc.library.sites import SiteLibrary
    from rholoc.library.stores import Stores

_MODULES = {
    "cameras": (
        "CameraLibrary",
        "CameraProfile",
        "check_camera_name",
    ),
    "data_import": (
        "ImportedData",
        "import_data",
    ),
    "folder_documents": (
        "Documents",
        "FolderDocuments",
    ),
    "maps": ("MapLibrary",),
    "queries": (
        "KeptLimits",
        "KeptQueries",
        "QueryStore",
    ),
    "recording_notes": (
        "WAYPOINTS_FILE",
        "RecordedWaypoint",
        "RecordingNotes",
        "corrected_waypoints",
        "read_notes",
        "read_thumbnail",
        "waypoints_file",
    ),
    "recordings": (
        "PendingRecording",
        "RecordingEntry",
        "RecordingStore",
    ),
    "sites": ("SiteLibrary",),
    "stores": ("Stores",),
}
_HOMES = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "WAYPOINTS_FILE",
    "CameraLibrary",
    "CameraProfile",
    "Documents",
    "FolderDocuments",
    "ImportedData",
    "KeptLimits",
    "KeptQueries",
    "MapLibrary",
    "PendingRecording",
    "QueryStore",
    "RecordedWaypoint",
    "RecordingEntry",
    "RecordingNotes",
    "RecordingStore",
    "SiteLibrary",
    "Stores",
    "check_camera_name",
    "corrected_waypoints",
    "import_data",
    "read_notes",
    "read_thumbnail",
    "waypoints_file",
]

__getattr__ = loader(__name__, _HOMES)
