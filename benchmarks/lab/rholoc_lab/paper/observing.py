"""A recording → Table 4: what was seen at which pixel from where, before there is a map (the paper's Figure 6)."""

import numpy as np

from rholoc.features import FeatureSet, get_extractor, widened
from rholoc.geometry import Camera, Pose
from rholoc.mapping.build.frame_features import FrameFeatures
from rholoc.mapping.build.view_choice import choose_views
from rholoc.maps import ObservationTable
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import Recording
from rholoc.trajectory import PoseMethod
from rholoc.trajectory.estimate import estimate_trajectory


def observe_recording(
    recording: Recording, features: str, poses: PoseMethod, progress: ProgressListener = silent
) -> tuple[ObservationTable, Camera]:
    """Every detection in every frame whose view is new, with its own descriptor, and the camera they belong to.

    Args:
        recording: with what ``poses`` needs.
        features: the extractor's name.
        poses: where frame poses come from; ``inertial`` is the paper's own, the IMU between waypoints.
        progress: hears how far it is.

    Raises:
        InvalidInput: there are no such features.
        InvalidRecording, InvalidCamera, InvalidWaypoints: the recording lacks what the poses need, or is damaged.
        MappingFailed: too few frames could be placed.
        Cancelled: ``progress`` asked to stop.
    """
    extractor = get_extractor(features)
    frames = FrameFeatures(recording.frames, widened(extractor, recording.camera))
    trajectory = estimate_trajectory(recording, poses, progress, frames.show)
    chosen, _ = choose_views(trajectory.T_map_camera, hold_out=False)
    found: list[FeatureSet] = []
    for shown in frames.of_keyframes(trajectory, chosen):
        found.append(shown.features)
        progress(Stage.FEATURES, len(found) / len(chosen), f"features of {len(found)} of {len(chosen)} frames")
    views = [Pose(T) for T in trajectory.T_map_camera[chosen]]
    view_of = np.repeat(np.arange(len(chosen)), [len(one) for one in found])
    every = FeatureSet.concatenate(found)
    table = ObservationTable(
        channels=every.channels,
        descriptors=every.descriptors,
        pixels=every.pixels.astype(np.float64),
        positions=np.array([view.position for view in views])[view_of],
        headings=np.array([view.heading for view in views])[view_of],
        times=trajectory.times[chosen][view_of],
        rolls=np.array([view.roll for view in views])[view_of],
    )
    return table, trajectory.camera
