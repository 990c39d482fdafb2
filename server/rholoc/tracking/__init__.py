"""Frames of a recording or a live camera → a pose for each, by a map on this machine; and where the poses go."""

from rholoc.tracking.follow import Answered, Answering, AtOnce, InBackground, Step, answer_of, follow
from rholoc.tracking.moments import (
    Moment,
    Motion,
    film_times,
    live_moments,
    odometry_of,
    paced,
    recorded_moments,
)
from rholoc.tracking.pose_bag import PoseBag
from rholoc.tracking.users import MessagesOfTrack, StepUser, TableOfTrack, Tally

__all__ = [
    "Answered",
    "Answering",
    "AtOnce",
    "InBackground",
    "MessagesOfTrack",
    "Moment",
    "Motion",
    "PoseBag",
    "Step",
    "StepUser",
    "TableOfTrack",
    "Tally",
    "answer_of",
    "film_times",
    "follow",
    "live_moments",
    "odometry_of",
    "paced",
    "recorded_moments",
]
