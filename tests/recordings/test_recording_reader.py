"""Whole recordings: folders of images, videos, rholoc's own folder and ZIP file."""

import errno
import gc
import shutil
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.errors import (
    InvalidCamera,
    InvalidRecording,
    InvalidTrajectory,
    InvalidWaypoints,
    RholocError,
    StorageFull,
    TooLarge,
)
from rholoc.geometry import Camera
from rholoc.recordings import (
    CameraFile,
    Imu,
    Waypoint,
    read_recording,
    write_camera_json,
    write_frames_csv,
    write_imu_csv,
    write_waypoints_csv,
)
from rholoc.recordings.recording import Recording
from rholoc.reports import WarningKind

CAMERA = Camera(64, 48, 60, 60, 32, 24)
INTRINSICS = "60,60,32,24"


def shades(recording: Recording, rows: list[int]) -> list[int]:
    return [round(float(image.mean())) for image in recording.frames.images(rows)]


def poses(keys: list[object]) -> str:
    return "".join(f"{key} {i} 0 0 0 0 0 1\n" for i, key in enumerate(keys))


def test_one_image(make_images, tmp_path: Path) -> None:
    make_images(tmp_path / "walk", range(3, 5))
    image = sorted((tmp_path / "walk").iterdir())[1]
    recording = read_recording(image, camera=INTRINSICS)
    assert (recording.name, recording.camera, recording.frames.timed) == (image.stem, CAMERA, False)
    assert recording.frames.numbers.tolist() == [4]
    assert shades(recording, [0]) == shades(read_recording(image.parent), [1])


@pytest.mark.parametrize("inside", ["", "frames", "images"])
def test_a_folder_of_images(make_images, tmp_path: Path, inside: str) -> None:
    make_images(tmp_path / "walk" / inside, range(3, 9))
    (tmp_path / "walk" / "README.md").write_text("not a frame")
    (tmp_path / "walk" / inside / "._frame-000004.png").write_text("not a frame either")
    recording = read_recording(tmp_path / "walk", camera=INTRINSICS)
    assert recording.name == "walk"
    assert recording.camera == CAMERA
    assert recording.frames.size == (64, 48)
    assert recording.frames.numbers.tolist() == [3, 4, 5, 6, 7, 8]
    assert not recording.frames.timed
    np.testing.assert_array_equal(recording.frames.times, np.arange(6))
    assert shades(recording, [0, 2, 5]) == [30, 50, 80]
    assert recording.imu is None
    assert recording.poses is None
    assert recording.waypoints == ()


def test_frames_are_ordered_by_number_not_by_name(make_images, tmp_path: Path) -> None:
    recording = read_recording(make_images(tmp_path / "walk", range(8, 12), "cam0_{}.png"))
    assert recording.frames.numbers.tolist() == [8, 9, 10, 11]
    assert shades(recording, [0, 3]) == [80, 110]


def test_times_come_from_a_table_or_from_fps(make_images, tmp_path: Path) -> None:
    folder = make_images(tmp_path / "walk")
    write_camera_json(folder / "camera.json", CameraFile(fps=10))
    np.testing.assert_allclose(read_recording(folder).frames.times, np.arange(6) / 10)
    write_frames_csv(folder / "times.csv", np.arange(10), 5 + np.arange(10) / 7)
    np.testing.assert_allclose(read_recording(folder).frames.times, 5 + np.arange(6) / 7, atol=1e-6)
    write_frames_csv(folder / "times.csv", np.arange(3), np.arange(3))
    with pytest.raises(InvalidRecording, match="no time for frame 3"):
        read_recording(folder)


@pytest.mark.parametrize("text", [f"{2**63}:", f":{10**20}", f"::{10**20}"])
def test_frames_beyond_64_bits_are_refused(make_images, tmp_path: Path, text: str) -> None:
    with pytest.raises(InvalidRecording, match="not a valid selection"):
        read_recording(make_images(tmp_path / "walk"), frames=text)


@pytest.mark.parametrize("text", ["2:5", "2:5:1", ":", "::2", "1:", ":3", "1:6:3"])
def test_frames_are_chosen_by_number_as_slices_are(make_images, tmp_path: Path, text: str) -> None:
    parts = [int(part) if part else None for part in text.split(":")]
    recording = read_recording(make_images(tmp_path / "walk"), frames=text)
    expected = list(range(6))[slice(*parts)]
    assert recording.frames.numbers.tolist() == expected
    assert shades(recording, [len(expected) - 1]) == [10 * expected[-1]]
    np.testing.assert_array_equal(recording.frames.times, np.arange(len(expected)))


def test_numbers_with_gaps_are_chosen_by_number(make_images, tmp_path: Path) -> None:
    folder = make_images(tmp_path / "walk", range(100, 120, 5))
    (folder / "poses.txt").write_text(poses([100, 105, 110, 115]))
    recording = read_recording(folder, frames="105:115")
    assert recording.frames.numbers.tolist() == [105, 110]
    assert recording.poses.T_map_camera[:, 0, 3].tolist() == [1, 2]


@pytest.mark.parametrize("text", ["", "5", "a:b", "1:2:3:4", "3:1", "100:200", "-3:", "::0", "1.5:3"])
def test_a_choice_that_is_none_is_reported(make_images, tmp_path: Path, text: str) -> None:
    with pytest.raises(InvalidRecording):
        read_recording(make_images(tmp_path / "walk"), frames=text)


@pytest.mark.parametrize(
    ("keys", "known"),
    [
        ([0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 4, 5]),
        ([5, 1], [1, 5]),
        ([0, 1, 2, 3, 4, 5, 6, 7], [0, 1, 2, 3, 4, 5]),  # more poses than frames
        ([0.001, "0.0667", 0.09], [0, 2, 3]),  # seconds
    ],
)
def test_poses_belong_to_frames_by_number_or_by_time(make_images, tmp_path: Path, keys, known) -> None:
    folder = make_images(tmp_path / "walk")
    (folder / "poses.txt").write_text(poses(keys))
    if isinstance(keys[0], float):
        with pytest.raises(InvalidTrajectory, match="without times"):
            read_recording(folder)
        write_camera_json(folder / "camera.json", CameraFile(fps=30))
    given = read_recording(folder).poses
    assert np.flatnonzero(given.known).tolist() == known
    order = np.argsort(np.array(keys, dtype=float))[: len(known)]
    np.testing.assert_allclose(given.T_map_camera[given.known, 0, 3], order, atol=1e-3)  # 0.0667 s is not 2/30 s
    assert np.isnan(given.T_map_camera[~given.known]).all()


def test_poses_of_another_recording_are_reported(make_images, tmp_path: Path) -> None:
    folder = make_images(tmp_path / "walk")
    (folder / "poses.csv").write_text(poses([100.5, 101.5]))
    with pytest.raises(InvalidTrajectory, match="No pose belongs"):
        read_recording(folder)


def test_broken_image_folders_are_reported(make_images, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidRecording, match="is empty"):
        read_recording(tmp_path / "empty")

    (tmp_path / "empty" / "notes.txt").write_text("hello")
    with pytest.raises(InvalidRecording, match="neither a video nor images"):
        read_recording(tmp_path / "empty")

    (tmp_path / "empty" / "IMG_0001.HEIC").write_bytes(b"")
    with pytest.raises(InvalidRecording, match=r"IMG_0001\.HEIC is a HEIC picture.*JPEG"):
        read_recording(tmp_path / "empty")

    (tmp_path / "empty" / "DSC1.tif").write_bytes(b"")
    with pytest.raises(InvalidRecording, match=r"DSC1\.tif is a TIF picture.*JPEG"):
        read_recording(tmp_path / "empty")

    with pytest.raises(InvalidRecording, match="There is no"):
        read_recording(tmp_path / "none")

    folder = make_images(tmp_path / "fake")
    (folder / "frame-000002.png").write_text("not a picture")
    with pytest.raises(InvalidRecording, match=r"frame-000002\.png"):
        read_recording(folder)


def test_pictures_of_several_sizes_become_frames_of_one_camera(make_images, tmp_path: Path) -> None:
    """A portrait picture among landscape ones: each lies in the middle of the frame, none is cut."""
    folder = make_images(tmp_path / "sizes")
    cv2.imwrite(str(folder / "frame-000006.png"), np.full((64, 48, 3), 200, np.uint8))
    frames = read_recording(folder).frames
    assert frames.size == (64, 64)
    *_, portrait = frames.images(range(7))
    assert portrait.shape == (64, 64, 3)
    assert int(portrait[32, 32, 0]) == 200


@pytest.mark.parametrize(("shape", "several"), [((64, 48, 3), False), ((24, 32, 3), True)])
def test_a_picture_of_another_size_may_be_of_another_camera(
    make_images, tmp_path: Path, shape: tuple[int, int, int], several: bool
) -> None:
    """Half as large may be by another lens; upright is the same camera."""
    folder = make_images(tmp_path / "sizes")
    cv2.imwrite(str(folder / "frame-000006.png"), np.full(shape, 200, np.uint8))
    assert read_recording(folder).lenses == (dict.fromkeys(range(6), 0) | {6: 1} if several else {})


def test_chosen_pictures_of_one_size_are_of_one_lens_and_lenses_count_from_the_commonest(
    make_images, tmp_path: Path
) -> None:
    folder = make_images(tmp_path / "sizes")
    for number, side in ((6, 96), (7, 96), (8, 192)):
        cv2.imwrite(str(folder / f"frame-{number:06d}.png"), np.full((side, side * 4 // 3, 3), 200, np.uint8))
    assert read_recording(folder, frames="6:8").lenses == {}
    assert read_recording(folder, frames="6:9").lenses == {6: 0, 7: 0, 8: 1}
    assert read_recording(folder, frames="5:9").lenses[5] == 0


@pytest.mark.parametrize("beside", [True, False])
def test_one_camera_is_not_taken_for_that_of_several_sizes(make_images, tmp_path: Path, beside: bool) -> None:
    """It counted for the size that they were resampled to, which nobody sees."""
    folder = make_images(tmp_path / "sizes")
    cv2.imwrite(str(folder / "frame-000006.png"), np.full((64, 48, 3), 200, np.uint8))
    if beside:
        write_camera_json(folder / "camera.json", CameraFile(Camera(64, 48, 50.0, 50.0, 31.5, 23.5)))
    with pytest.raises(InvalidCamera, match=r"several sizes or lenses \(64×48, 48×64\)") as raised:
        read_recording(folder, None if beside else "50,50,31.5,23.5")
    assert raised.value.hint.startswith("Leave it out")


def test_files_without_numbers_are_counted_in_the_order_of_their_names(make_images, tmp_path: Path) -> None:
    folder = make_images(tmp_path / "nameless")
    cv2.imwrite(str(folder / "cover.png"), np.full((48, 64, 3), 200, np.uint8))
    recording = read_recording(folder)
    assert recording.frames.numbers.tolist() == list(range(7))
    assert shades(recording, [0]) == [200]


def test_of_two_files_with_one_number_both_are_read(make_images, tmp_path: Path) -> None:
    folder = make_images(tmp_path / "twice")
    cv2.imwrite(str(folder / "other-2.png"), np.full((48, 64, 3), 200, np.uint8))
    assert shades(read_recording(folder), [5, 6]) == [50, 200]


def test_a_truncated_image_is_reported_when_it_is_read(make_images, tmp_path: Path) -> None:
    folder = make_images(tmp_path / "walk")
    path = folder / "frame-000003.png"
    path.write_bytes(path.read_bytes()[:-40])
    recording = read_recording(folder)
    assert shades(recording, [2, 4]) == [20, 40]
    with pytest.raises(InvalidRecording, match=r"frame-000003\.png"):
        list(recording.frames.images([2, 3]))


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".avi", ".mkv"])
def test_a_bare_video(make_video, tmp_path: Path, suffix: str) -> None:
    recording = read_recording(make_video(tmp_path / f"clip{suffix}"), camera=INTRINSICS, frames="2:10:2")
    assert recording.name == "clip"
    assert recording.camera == CAMERA
    assert recording.frames.numbers.tolist() == [2, 4, 6, 8]
    np.testing.assert_allclose(recording.frames.times, [0.1, 0.2, 0.3, 0.4], atol=1e-3)
    np.testing.assert_allclose(shades(recording, [0, 3]), [30, 120], atol=4)


def test_an_image_that_changed_after_it_was_listed_is_reported(make_images, tmp_path: Path) -> None:
    recording = read_recording(make_images(tmp_path / "walk"))
    cv2.imwrite(str(tmp_path / "walk" / "frame-000002.png"), np.zeros((10, 10, 3), np.uint8))
    with pytest.raises(InvalidRecording, match=r"frame-000002\.png"):
        list(recording.frames.images([2]))


def test_any_rows_of_a_video_are_the_same_as_all_rows(make_video, tmp_path: Path) -> None:
    frames = read_recording(make_video(tmp_path / "clip.mp4")).frames
    everything = list(frames.images(range(12)))
    assert len(everything) == 12
    for rows in ([0], [11], [3, 4, 9]):
        for row, image in zip(rows, frames.images(rows), strict=True):
            np.testing.assert_array_equal(image, everything[row])
    with pytest.raises(ValueError, match="increase"):
        list(frames.images([3, 3]))


def test_broken_videos_are_reported(make_video, tmp_path: Path) -> None:
    whole = make_video(tmp_path / "whole.mp4").read_bytes()
    for name, data in {"empty": b"", "text": b"not a video" * 50, "cut": whole[: len(whole) // 2]}.items():
        (tmp_path / f"{name}.mp4").write_bytes(data)
        with pytest.raises(InvalidRecording, match=f"{name}.mp4"):
            read_recording(tmp_path / f"{name}.mp4")
    with pytest.raises(InvalidRecording, match="frameless"):
        read_recording(make_video(tmp_path / "frameless.mp4", frames=0))


def test_a_video_that_ends_early_is_read_with_a_warning(make_video, tmp_path: Path) -> None:
    whole = make_video(tmp_path / "whole.avi", frames=60)
    assert not read_recording(whole).warnings
    data = whole.read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: len(data) // 2])
    cut = read_recording(tmp_path / "cut.avi")
    count = len(cut.frames.times)
    assert 0 < count < 60
    assert [one.text for one in cut.warnings] == [
        f"The video ends after {count} of its 60 frames: the file seems cut short."
    ]


def test_a_broken_video_is_reported_in_one_line(capfd: pytest.CaptureFixture[str], make_video, tmp_path: Path) -> None:
    whole = make_video(tmp_path / "whole.mp4", frames=60).read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    codec = whole.index(b"\x20\x11", whole.index(b"esds"))  # MPEG-4 by its number, beside its name
    foreign = whole[:codec] + b"\xfe" + whole[codec + 1 :]
    (tmp_path / "foreign.mp4").write_bytes(foreign.replace(b"mp4v", b"zzzz"))
    capfd.readouterr()
    for name in ("cut.mp4", "foreign.mp4"):
        with pytest.raises(InvalidRecording, match=name):
            read_recording(tmp_path / name)
        assert capfd.readouterr() == ("", "")


def test_a_video_that_shrinks_after_it_was_read_is_reported(make_video, tmp_path: Path) -> None:
    frames = read_recording(make_video(tmp_path / "clip.avi")).frames
    make_video(tmp_path / "clip.avi", frames=5)
    with pytest.raises(InvalidRecording, match="Frame 8"):
        list(frames.images([1, 8]))


def test_an_unknown_format_names_those_known(tmp_path: Path) -> None:
    (tmp_path / "walk.film").write_bytes(b"#FILM V2.0")
    with pytest.raises(InvalidRecording) as caught:
        read_recording(tmp_path / "walk.film")
    assert all(word in caught.value.hint for word in (".mp4", ".zip", "imu.csv", "frames/"))


@pytest.fixture
def own(make_video, tmp_path: Path) -> Path:
    """rholoc's own recording, whole: 12 frames at 20 a second."""
    folder = tmp_path / "phone"
    make_video(folder / "video.mp4")
    write_frames_csv(folder / "frames.csv", np.arange(12), 50 + np.arange(12) / 20)
    times = 49.9 + np.arange(160) / 200
    write_imu_csv(folder / "imu.csv", Imu(times, np.zeros((160, 3)), np.zeros((160, 3)), False, None))
    waypoints = [Waypoint(f"W{i}", 50 + 0.2 * i, (i, i * i, 1.5)) for i in range(3)]
    write_waypoints_csv(folder / "waypoints.csv", waypoints)
    write_camera_json(folder / "camera.json", CameraFile(CAMERA, R_camera_imu=np.eye(3), gravity_included=False))
    return folder


def zipped(folder: Path, inside: str = "") -> Path:
    path = folder.with_suffix(".zip")
    with zipfile.ZipFile(path, "w") as archive:
        for file in sorted(folder.rglob("*")):
            archive.write(file, Path(inside) / file.relative_to(folder))
    return path


def check_whole(recording: Recording) -> None:
    assert recording.name == "phone"
    assert recording.camera == CAMERA
    np.testing.assert_allclose(recording.frames.times, 50 + np.arange(12) / 20)
    assert recording.imu.R_camera_imu is not None
    assert not recording.imu.includes_gravity
    assert [waypoint.name for waypoint in recording.waypoints] == ["W0", "W1", "W2"]
    np.testing.assert_allclose(shades(recording, [3, 7]), [45, 105], atol=4)


def test_our_own_folder(own: Path) -> None:
    check_whole(read_recording(own))


@pytest.mark.parametrize("inside", ["", "phone", "another name"])
def test_our_own_zip_file_and_its_temporary_folder(own: Path, inside: str) -> None:
    recording = read_recording(zipped(own, inside))
    check_whole(recording)
    unpacked = recording.path
    chosen = read_recording(zipped(own, inside), frames="2:5")
    kept = chosen.path
    del recording
    gc.collect()
    assert not unpacked.exists()
    assert kept.exists()
    np.testing.assert_allclose(shades(chosen, [0]), [30], atol=4)


@pytest.mark.parametrize("beside", ["", "README.txt", ".DS_Store", "__MACOSX/._phone"])
def test_a_recording_is_found_in_the_only_folder_however_deep(own: Path, beside: str, tmp_path: Path) -> None:
    folder = tmp_path / "sent"
    shutil.copytree(own, folder / "data" / "2026" / "scan")
    if beside:
        (folder / beside).parent.mkdir(exist_ok=True)
        (folder / beside).write_text("notes")
    for path in (folder, zipped(folder)):
        recording = read_recording(path)
        assert recording.name == "sent"
        assert recording.camera == CAMERA
        assert len(recording.waypoints) == 3


def test_a_folder_called_like_a_note_holds_a_recording(own: Path, tmp_path: Path) -> None:
    shutil.copytree(own, tmp_path / "sent" / "license-plates")
    assert read_recording(tmp_path / "sent").camera == CAMERA


def test_a_table_beside_the_only_folder_is_not_lost(own: Path, tmp_path: Path) -> None:
    shutil.copytree(own, tmp_path / "sent" / "walk")
    shutil.move(own / "waypoints.csv", tmp_path / "sent" / "waypoints.csv")
    with pytest.raises(InvalidRecording, match="neither a video nor images"):
        read_recording(tmp_path / "sent")


@pytest.mark.parametrize("mask", ["frame-{:06d}_mask.png", "frame-{:06d}.mask.png", "frame-{:06d}.png.png"])
def test_masks_beside_the_pictures_are_no_pictures(make_images, mask: str, tmp_path: Path) -> None:
    make_images(tmp_path / "walk")
    make_images(tmp_path / "walk", name=mask)
    recording = read_recording(tmp_path / "walk")
    assert recording.frames.numbers.tolist() == list(range(6))
    (warning,) = recording.warnings
    assert warning.kind is WarningKind.NOT_USED
    assert mask.format(0) in warning.text


@pytest.mark.parametrize("name", ["{:03d}_mask.png", "{:03d}.mask.png", "{:03d}.jpg.png"])
def test_pictures_that_are_only_called_masks_are_pictures(make_images, name: str, tmp_path: Path) -> None:
    make_images(tmp_path / "walk", name=name)
    assert len(read_recording(tmp_path / "walk").frames.times) == 6


def test_folders_with_pictures_are_named_where_there_are_several(make_images, tmp_path: Path) -> None:
    for name in (".thumbnails", "cam0", "cam1", "cam2", "cam3", "cam4"):
        make_images(tmp_path / "walk" / name)
    with pytest.raises(InvalidRecording) as caught:
        read_recording(tmp_path / "walk")
    assert caught.value.hint == "There are pictures in cam0, cam1, cam2, cam3 and 1 more: give one of these folders."


def test_a_zip_file_is_unpacked_into_the_workdir_and_stays(own: Path, tmp_path: Path) -> None:
    workdir = tmp_path / "work"
    workdir.mkdir()
    (workdir / "other.txt").write_text("stays")
    path = read_recording(zipped(own), workdir=workdir).path
    gc.collect()
    assert path.is_dir()
    assert path.is_relative_to(workdir)
    shutil.rmtree(path)
    (own / "imu.csv").write_text("broken")
    with pytest.raises(InvalidRecording):
        read_recording(zipped(own), workdir=workdir)
    assert [file.name for file in workdir.iterdir()] == ["other.txt"]


def test_our_own_folder_with_images(own: Path, make_images) -> None:
    (own / "video.mp4").unlink()
    make_images(own / "frames", range(12))
    recording = read_recording(own)
    assert recording.frames.times[0] == 50
    assert shades(recording, [3]) == [30]
    assert read_recording(zipped(own)).frames.size == (64, 48)


def test_a_zip_file_with_nothing_but_frames(make_images, tmp_path: Path) -> None:
    make_images(tmp_path / "walk" / "frames")
    assert len(read_recording(zipped(tmp_path / "walk")).frames.times) == 6


@pytest.mark.parametrize(("count", "fits"), [(9, False), (10, True), (11, True), (13, True), (14, True), (15, False)])
def test_the_table_of_times_must_agree_with_the_video(own: Path, count: int, fits: bool) -> None:
    write_frames_csv(own / "frames.csv", np.arange(count), 50 + np.arange(count) / 20)
    if fits:
        assert len(read_recording(own).frames.times) == min(count, 12)
    else:
        with pytest.raises(InvalidRecording, match=f"{count} frames, but video.mp4 has 12"):
            read_recording(own)


def test_a_gap_in_the_table_of_times_is_refused(own: Path) -> None:
    numbers = np.delete(np.arange(12), 5)
    write_frames_csv(own / "frames.csv", numbers, 50 + numbers / 20)
    with pytest.raises(InvalidRecording, match=r"frames\.csv has no time for frame 5 "):
        read_recording(own)


def test_several_videos_are_reported(own: Path, make_video) -> None:
    make_video(own / "second.mp4")
    check_whole(read_recording(own))  # video.mp4 is the one
    (own / "video.mp4").rename(own / "first.mp4")
    with pytest.raises(InvalidRecording, match=r"first\.mp4, second\.mp4"):
        read_recording(own)


def test_a_camera_of_another_resolution_is_scaled_and_of_another_shape_refused(own: Path) -> None:
    write_camera_json(own / "camera.json", CameraFile(CAMERA.resized(640, 480)))
    camera = read_recording(own).camera
    np.testing.assert_allclose([camera.width, camera.fx, camera.cx], [64, 60, 32])
    write_camera_json(own / "camera.json", CameraFile(Camera(48, 64, 60, 60, 24, 32)))
    with pytest.raises(InvalidCamera, match="48×64"):
        read_recording(own)
    with pytest.raises(InvalidCamera):
        read_recording(own / "video.mp4", camera="nonsense")


def test_a_choice_of_frames_drops_waypoints_outside_but_given_ones_must_lie_inside(own: Path) -> None:
    assert [waypoint.name for waypoint in read_recording(own, frames="0:6").waypoints] == ["W0", "W1"]
    assert len(read_recording(own, waypoints=own / "waypoints.csv").waypoints) == 3
    with pytest.raises(InvalidWaypoints, match="W2"):
        read_recording(own, frames="0:6", waypoints=own / "waypoints.csv")


def raw_zip(path: Path, entries: dict[str, bytes], modes: dict[str, int] | None = None) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = (modes or {}).get(name, 0o100644) << 16
            archive.writestr(info, data)
    return path


@pytest.mark.parametrize("name", ["../evil.csv", "/etc/evil.csv", "a/../../evil.csv", "..\\evil.csv", "C:\\evil.csv"])
def test_a_zip_file_that_reaches_outside_is_refused(tmp_path: Path, name: str) -> None:
    workdir = tmp_path / "deep" / "work"
    workdir.mkdir(parents=True)
    with pytest.raises(InvalidRecording, match="outside"):
        read_recording(raw_zip(tmp_path / "evil.zip", {name: b"x"}), workdir=workdir)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["deep", "evil.zip", "work"]


def test_a_zip_files_own_folder_and_apples_files_are_ignored(make_images, tmp_path: Path) -> None:
    (image,) = list(make_images(tmp_path / "walk").iterdir())[:1]
    entries = {"./": b"", "0.png": image.read_bytes(), "._0.png": b"\0\5\x16\7"}
    assert len(read_recording(raw_zip(tmp_path / "walk.zip", entries)).frames.times) == 1


def test_a_zip_file_with_a_link_is_refused(tmp_path: Path) -> None:
    path = raw_zip(tmp_path / "link.zip", {"imu.csv": b"/etc/passwd"}, {"imu.csv": 0o120777})
    with pytest.raises(InvalidRecording, match="link"):
        read_recording(path)


def test_a_bomb_is_refused_before_it_unpacks(own: Path, tmp_path: Path) -> None:
    bomb = raw_zip(tmp_path / "bomb.zip", {"imu.csv": b"\0" * 30_000_000})
    with pytest.raises(TooLarge, match="compression ratio"):
        read_recording(bomb)
    with pytest.raises(TooLarge, match="would unpack"):
        read_recording(zipped(own), max_unpacked_bytes=1000)


def test_a_zip_file_that_lies_about_sizes_writes_no_more_than_declared(tmp_path: Path) -> None:
    path = raw_zip(tmp_path / "liar.zip", {"imu.csv": bytes(range(256)) * 4000})
    data = bytearray(path.read_bytes())
    directory = data.rindex(b"PK\x01\x02")
    data[directory + 24 : directory + 28] = (100).to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(InvalidRecording):
        read_recording(path, workdir=tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["liar.zip"]


def test_a_full_disk_leaves_nothing_unpacked(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    workdir = tmp_path / "work"
    workdir.mkdir()
    path = zipped(own)
    monkeypatch.setattr("rholoc.recordings.archive.shutil.copyfileobj", full)
    with pytest.raises(StorageFull):
        read_recording(path, workdir=workdir)
    assert list(workdir.iterdir()) == []


def test_damaged_zip_files_are_reported(own: Path, tmp_path: Path) -> None:
    whole = zipped(own).read_bytes()
    rng = np.random.default_rng(5)
    path = tmp_path / "damaged.zip"
    refused = 0
    for position in [0, 1, *rng.integers(0, len(whole), 60)]:
        damaged = bytearray(whole)
        damaged[position] ^= 0xFF
        path.write_bytes(damaged)
        try:
            read_recording(path)
        except RholocError as error:
            refused += 1
            assert "\n" not in str(error)  # noqa: PT017
    assert refused > 10
    for data in (b"", b"PK", whole[: len(whole) // 2]):
        path.write_bytes(data)
        with pytest.raises(InvalidRecording, match="not a complete ZIP"):
            read_recording(path)


def test_a_zip_file_without_a_recording_is_called_as_its_user_calls_it(tmp_path: Path) -> None:
    zipfile.ZipFile(tmp_path / "monday.zip", "w").close()
    with pytest.raises(InvalidRecording, match=r"^The file monday.zip is empty\."):
        read_recording(tmp_path / "monday.zip")


def test_waypoints_of_pictures_without_times_stay_with_their_pictures_when_some_are_chosen(
    make_images, tmp_path: Path
) -> None:
    folder = make_images(tmp_path / "walk", range(10, 20))
    (folder / "waypoints.csv").write_text("name,frame,x,y,z\nA,11,0,0,1\nB,14,1,0,1\nC,16,0,1,1\n")
    chosen = read_recording(folder, frames="12:20:2")
    assert chosen.frames.numbers.tolist() == [12, 14, 16, 18]
    assert [(one.name, one.time) for one in chosen.waypoints] == [("B", 1.0), ("C", 2.0)]
