"""Keeping track of a camera between answers. It needs NumPy: ``pip install 'rholoc-client[tracking]'``."""

from rholoc_client.tracking.belief import OdometryNoise
from rholoc_client.tracking.following import AnsweredMatches, FollowedTrack
from rholoc_client.tracking.inertial import ImuNoise
from rholoc_client.tracking.track import Answer, Question, Track, Tracked, TrackOptions, TrackStatus
from rholoc_client.tracking.tracker import AsyncTracker, Tracker

__all__ = [
    "Answer",
    "AnsweredMatches",
    "AsyncTracker",
    "FollowedTrack",
    "ImuNoise",
    "OdometryNoise",
    "Question",
    "Track",
    "TrackOptions",
    "TrackStatus",
    "Tracked",
    "Tracker",
]
