"""Problems of a whole recording, whatever its format."""

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.recordings.frames.video import VideoFrames
from rholoc.recordings.imu_normalisation import gap_rows
from rholoc.recordings.recording import FrameSource, Imu, Recording
from rholoc.reports import RecordingWarning, WarningKind

_WHOLE = 0.95  # of the frames that a video's index announces
_MARGIN_S = 0.5  # tolerated time of frames before and after the IMU's table


def whole_warnings(recording: Recording) -> tuple[RecordingWarning, ...]:
    """Warnings of a video that ends early, of gaps between frames, and of frames that the IMU does not cover (by more
    than 0.5 s); or of frames without times.
    """
    if not recording.frames.timed:
        text = "The pictures have no times, so the IMU cannot be used: add frames.csv with frame,timestamp."
        return () if recording.imu is None else (RecordingWarning(WarningKind.NO_OVERLAP, text),)
    found = [*_cut_short(recording.frames), *_frame_gaps(recording.frames.times)]
    if recording.imu is not None:
        found += _uncovered(recording.frames.times, recording.imu)
    return tuple(found)


def _cut_short(frames: FrameSource) -> tuple[RecordingWarning, ...]:
    """A warning if a video has under 95 % of the frames that it announces, else none."""
    if not isinstance(frames, VideoFrames) or len(frames.times) >= _WHOLE * frames.announced:
        return ()
    text = f"The video ends after {len(frames.times)} of its {frames.announced} frames: the file seems cut short."
    return (RecordingWarning(WarningKind.FRAME_COUNT, text),)


def _frame_gaps(times: FloatArray) -> tuple[RecordingWarning, ...]:
    """A warning if frames at ``times`` (N,) [s] have gaps, see :func:`gap_rows`, else none."""
    gaps = gap_rows(times)
    if len(gaps) == 0:
        return ()
    longest_s = float(np.diff(times)[gaps].max())
    text = f"There are {len(gaps)} gaps between frames, the longest {longest_s:.2f} s; the path may break there."
    return (RecordingWarning(WarningKind.FRAME_GAP, text),)


def _uncovered(times: FloatArray, imu: Imu) -> tuple[RecordingWarning, ...]:
    """A warning if frames at ``times`` (N,) [s] are over 0.5 s before or after the IMU's readings, else none."""
    covered = (times >= imu.times[0] - _MARGIN_S) & (times <= imu.times[-1] + _MARGIN_S)
    if covered.all():
        return ()
    if covered.any():
        text = f"The motion sensors cover {covered.mean():.0%} of the frames; the rest is placed by the images alone."
    else:
        text = (
            f"IMU and frames have no common time: {imu.times[0]:.3f}–{imu.times[-1]:.3f} s and "
            f"{times[0]:.3f}–{times[-1]:.3f} s; the IMU cannot be used."
        )
    return (RecordingWarning(WarningKind.NO_OVERLAP, text),)
