"""What a server keeps: maps, recordings, kept queries, cameras and sites.

Names are imported when they are first asked for: cameras are kept where nothing of a server is installed, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rholoc.lazy import loader

if TYPE_CHECKING:
    from rholoc.library.cameras import CameraLibrary as CameraLibrary
    from rholoc.library.cameras import CameraProfile as CameraProfile
    from rholoc.library.cameras import check_camera_name as check_camera_name
    from rholoc.library.data_import import ImportedData as ImportedData
    from rholoc.library.data_import import import_data as import_data
    from rholoc.library.documents import Documents as Documents
    from rholoc.library.documents import FolderDocuments as FolderDocuments
    from rholoc.library.maps import MapLibrary as MapLibrary
    from rholoc.library.queries import KeptLimits as KeptLimits
    from rholoc.library.queries import KeptQueries as KeptQueries
    from rholoc.library.queries import QueryStore as QueryStore
    from rholoc.library.recording_notes import WAYPOINTS_FILE as WAYPOINTS_FILE
    from rholoc.library.recording_notes import RecordedWaypoint as RecordedWaypoint
    from rholoc.library.recording_notes import RecordingNotes as RecordingNotes
    from rholoc.library.recording_notes import corrected_waypoints as corrected_waypoints
    from rholoc.library.recording_notes import read_notes as read_notes
    from rholoc.library.recording_notes import read_thumbnail as read_thumbnail
    from rholoc.library.recording_notes import waypoints_file as waypoints_file
    from rholoc.library.recordings import PendingRecording as PendingRecording
    from rholoc.library.recordings import RecordingEntry as RecordingEntry
    from rholoc.library.recordings import RecordingStore as RecordingStore
    from rholoc.library.sites import SiteLibrary as SiteLibrary
    from rholoc.library.stores import Stores as Stores

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
    "documents": (
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
