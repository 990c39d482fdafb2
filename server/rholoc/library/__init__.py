"""What a server keeps: maps, recordings, kept queries, cameras and sites."""

from rholoc.library.cameras import CameraLibrary, CameraProfile, check_camera_name
from rholoc.library.data_import import ImportedData, import_data
from rholoc.library.documents import Documents, FolderDocuments
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
