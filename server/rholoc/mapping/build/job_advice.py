"""Advice of a mapping job on its recordings: problems, figures of the walk, and what to do better next time."""

from collections.abc import Sequence

import numpy as np

from rholoc.errors import InvalidRecording, MappingFailed
from rholoc.geometry import FloatArray
from rholoc.recordings import Look, Recording, advise, look_through, measure_walk
from rholoc.reports import CoachingReport


def coaching_report(
    recording: Recording, looks: Sequence[Look], times: FloatArray, T_map_camera: FloatArray
) -> CoachingReport:
    """Report on one recording, from its frames' appearance and the poses (N, 4, 4) at times (N,) [s]; N may be 0."""
    figures = measure_walk(recording, looks, times, T_map_camera)
    return CoachingReport(recording.name, figures, recording.warnings, advise(figures))


def advice_line(coaching: Sequence[CoachingReport]) -> str:
    """All advice of the reports in one line that begins with "next time:"; empty if there is none."""
    texts = [advice.text for section in coaching for advice in section.advice]
    return f"next time: {' '.join(texts)}" if texts else ""


def with_advice(failure: MappingFailed, recording: Recording) -> MappingFailed:
    """A copy of ``failure`` with the recording's problems, and advice drawn from its frames and IMU, added to its hint;
    ``failure`` itself if a frame cannot be decoded.
    """
    try:
        section = coaching_report(recording, look_through(recording.frames), np.zeros(0), np.zeros((0, 4, 4)))
    except InvalidRecording:
        return failure
    texts = [warning.text for warning in section.warnings] + [advice.text for advice in section.advice]
    return MappingFailed(failure.message, " ".join([failure.hint, *texts]).strip())
