"""Models by other programs, as users have them: several models, other paths, other ways to state the intrinsics."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import phone_recordings as phone
import pytest

from rholoc.errors import InvalidCamera, InvalidRecording, InvalidTrajectory
from rholoc.geometry import Lens
from rholoc.recordings import Recording, RecordingFormat, read_recording
from rholoc.reports import WarningKind


def not_used(recording: Recording) -> list[str]:
    return [warning.text for warning in recording.warnings if warning.kind is WarningKind.NOT_USED]


def split_colmap(folder: Path, first: int) -> None:
    """Split the model in sparse/0: the ``first`` images stay, the others become sparse/1."""
    head, *lines = (folder / "sparse" / "0" / "images.txt").read_text().splitlines()
    (folder / "sparse" / "1").mkdir()
    (folder / "sparse" / "1" / "cameras.txt").write_text((folder / "sparse" / "0" / "cameras.txt").read_text())
    for model, part in ((0, lines[: 2 * first]), (1, lines[2 * first :])):
        (folder / "sparse" / str(model) / "images.txt").write_text("\n".join([head, *part]) + "\n")


@pytest.mark.parametrize(("first", "read", "left"), [(5, "1", "0"), (20, "0", "1")])
def test_of_several_colmap_models_the_one_with_most_pictures_is_read(
    first: int, read: str, left: str, tmp_path: Path
) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    split_colmap(folder, first)
    recording = read_recording(folder)
    assert len(recording.frames.times) == max(first, phone.FRAMES - first)
    (text,) = (one for one in not_used(recording) if "models" in one)
    assert f"sparse/{read} is read" in text
    assert f"sparse/{left} ({min(first, phone.FRAMES - first)})" in text


def test_a_colmap_model_need_not_have_the_number_0(tmp_path: Path) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    (folder / "sparse" / "0").rename(folder / "sparse" / "2")
    recording = read_recording(folder)
    assert recording.format is RecordingFormat.COLMAP
    assert not not_used(recording)


@pytest.mark.parametrize("place", ["colmap/sparse/0", "colmap_sparse/0", "colmap_text"])
def test_models_that_nerfstudio_and_instant_ngp_had_colmap_write_are_read(place: str, tmp_path: Path) -> None:
    folder = phone.write_recording("colmap", tmp_path / "walk")
    (folder / place).parent.mkdir(exist_ok=True, parents=True)
    (folder / "sparse" / "0").rename(folder / place)
    (folder / "sparse").rmdir()
    (folder / "transforms_backup.json").write_text("{")
    recording = read_recording(folder)
    assert recording.format is RecordingFormat.COLMAP
    assert recording.poses.known.all()
    assert not [text for text in not_used(recording) if "colmap" in text]


@pytest.mark.parametrize("place", ["colmap/sparse/0", "colmap_text"])
def test_transforms_are_read_rather_than_the_model_that_they_were_made_from(place: str, tmp_path: Path) -> None:
    folder = phone.write_recording("nerfstudio", tmp_path / "walk")
    (phone.write_recording("colmap", tmp_path / "other") / "sparse" / "0").rename(tmp_path / "model")
    (folder / place).parent.mkdir(exist_ok=True, parents=True)
    (tmp_path / "model").rename(folder / place)
    recording = read_recording(folder)
    assert recording.format is RecordingFormat.NERFSTUDIO
    assert not not_used(recording)


def test_images_of_a_colmap_model_without_their_lines_of_points_are_refused(tmp_path: Path) -> None:
    path = phone.write_recording("colmap", tmp_path / "walk") / "sparse" / "0" / "images.txt"
    lines = [line for line in path.read_text().splitlines() if "walk/" in line or line.startswith("#")]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InvalidRecording, match=r"images\.txt: the line after walk/frame0023\.png"):
        read_recording(tmp_path / "walk")


def write_transforms(folder: Path, **changes: Any) -> dict[str, Any]:
    """The walk as ``transforms.json`` with some members changed; None removes one. Returns what is written."""
    path = phone.write_recording("nerfstudio", folder) / "transforms.json"
    values = {name: value for name, value in {**json.loads(path.read_text()), **changes}.items() if value is not None}
    path.write_text(json.dumps(values))
    return values


def test_a_scale_that_nerfstudio_applied_is_undone(tmp_path: Path) -> None:
    values = write_transforms(tmp_path / "walk", applied_scale=0.25)
    for frame in values["frames"]:
        for row in frame["transform_matrix"][:3]:
            row[3] *= 0.25
    (tmp_path / "walk" / "transforms.json").write_text(json.dumps(values))
    poses = read_recording(tmp_path / "walk").poses
    np.testing.assert_allclose(poses.T_map_camera, phone.camera_poses(phone.R_PORTRAIT_CAMERA_IMU), atol=1e-9)


@pytest.mark.parametrize("scale", [0, -1, "big", [1]])
def test_an_impossible_applied_scale_is_refused(scale: Any, tmp_path: Path) -> None:
    write_transforms(tmp_path / "walk", applied_scale=scale)
    with pytest.raises(InvalidTrajectory, match="applied_scale is not a scale"):
        read_recording(tmp_path / "walk")


def test_the_parts_of_a_set_in_files_of_their_own_are_read_together(tmp_path: Path) -> None:
    values = write_transforms(tmp_path / "walk")
    (tmp_path / "walk" / "transforms.json").unlink()
    frames = values.pop("frames")
    for name, part in (("train", frames[:10]), ("val", frames[10:15]), ("test", frames[15:])):
        (tmp_path / "walk" / f"transforms_{name}.json").write_text(json.dumps({**values, "frames": part}))
    (tmp_path / "walk" / "transforms_backup.json").write_text("{")
    recording = read_recording(tmp_path / "walk")
    assert recording.format is RecordingFormat.NERFSTUDIO
    expected = phone.camera_poses(phone.R_PORTRAIT_CAMERA_IMU)
    np.testing.assert_allclose(recording.poses.T_map_camera, expected, atol=1e-9)
    assert any("transforms_backup.json" in text for text in not_used(recording))


FX, FY = phone.INTRINSICS[:2]
ANGLE_X, ANGLE_Y = 2 * math.atan(32 / FX), 2 * math.atan(24 / FY)


@pytest.mark.parametrize(
    ("stated", "focals"),
    [
        ({"camera_angle_x": ANGLE_X}, (FX, FX)),
        ({"camera_angle_y": ANGLE_Y}, (FY, FY)),
        ({"camera_angle_x": ANGLE_X, "camera_angle_y": ANGLE_Y}, (FX, FY)),
        ({"x_fov": math.degrees(ANGLE_X)}, (FX, FX)),
        ({"fl_y": FY}, (FY, FY)),
    ],
)
def test_focal_lengths_may_be_stated_as_angles(
    stated: dict[str, float], focals: tuple[float, float], tmp_path: Path
) -> None:
    write_transforms(tmp_path / "walk", **{"fl_x": None, "fl_y": None} | stated)
    camera = read_recording(tmp_path / "walk").camera
    assert (camera.fx, camera.fy) == pytest.approx(focals)


@pytest.mark.parametrize("name", ["ftheta_p0", "latlong", "equirectangular"])
def test_a_lens_that_only_instant_ngp_has_is_named(name: str, tmp_path: Path) -> None:
    write_transforms(tmp_path / "walk", **{name: 0.0 if name == "ftheta_p0" else True})
    recording = read_recording(tmp_path / "walk")
    assert recording.camera is None
    assert WarningKind.CAMERA_UNSUPPORTED in [warning.kind for warning in recording.warnings]


@pytest.mark.parametrize("value", [False, 0])
@pytest.mark.parametrize("name", ["is_fisheye", "latlong", "equirectangular"])
def test_a_lens_of_instant_ngp_that_is_denied_is_none(name: str, value: Any, tmp_path: Path) -> None:
    write_transforms(tmp_path / "walk", **{name: value})
    assert read_recording(tmp_path / "walk").camera.lens is Lens.PINHOLE


def test_all_coefficients_of_full_opencv_are_read(tmp_path: Path) -> None:
    write_transforms(tmp_path / "walk", camera_model="FULL_OPENCV", k3=0.01, k4=0.02, k5=0.03, k6=0.04)
    assert read_recording(tmp_path / "walk").camera.distortion == (0.1, -0.05, 0.001, 0.002, 0.01, 0.02, 0.03, 0.04)


def test_the_fourth_radial_coefficient_of_nerfstudio_is_not_lost(tmp_path: Path) -> None:
    write_transforms(tmp_path / "walk", k3=0.01, k4=0.3)
    camera = read_recording(tmp_path / "walk").camera
    r2 = 0.5**2  # at x = 0.4, y = 0.3
    radial = 1 + 0.1 * r2 - 0.05 * r2**2 + 0.01 * r2**3 + 0.3 * r2**4
    tangential = 2 * 0.001 * 0.12 + 0.002 * (r2 + 2 * 0.16), 0.001 * (r2 + 2 * 0.09) + 2 * 0.002 * 0.12
    expected = (0.4 * radial + tangential[0]) * FX + 31.5, (0.3 * radial + tangential[1]) * FY + 23.5
    np.testing.assert_allclose(camera.project(np.array([[0.4, 0.3, 1.0]])), [expected], atol=0.02)


@pytest.mark.parametrize(
    ("listed", "file"),
    [
        ("images\\frame_1.png", "images/frame_1.png"),
        ("./images/frame_1", "images/frame_1.JPG"),
        ("images/frame_1", "images/frame_1.jpeg"),
        ("images/scan.0001", "images/scan.0001.png"),
    ],
)
def test_pictures_are_found_by_paths_as_windows_has_them_and_without_suffix(
    listed: str, file: str, tmp_path: Path
) -> None:
    values = write_transforms(tmp_path / "walk")
    frame = values["frames"][0]
    (tmp_path / "walk" / frame["file_path"]).rename(tmp_path / "walk" / file)
    values["frames"] = [{**frame, "file_path": listed}]
    (tmp_path / "walk" / "transforms.json").write_text(json.dumps(values))
    assert read_recording(tmp_path / "walk").frames.paths == (tmp_path / "walk" / file,)


@pytest.mark.parametrize("listed", ["\ud800.png", "a/" * 2500 + "b.png", "a\\" * 2500 + "b", "a" * 300])
def test_a_path_that_no_file_can_have_is_refused(listed: str, tmp_path: Path) -> None:
    values = write_transforms(tmp_path / "walk")
    values["frames"][0]["file_path"] = listed
    (tmp_path / "walk" / "transforms.json").write_text(json.dumps(values))
    with pytest.raises(InvalidRecording, match=r"The list of images names .* which is (too long|not valid text)"):
        read_recording(tmp_path / "walk")


def test_a_position_beyond_reason_is_refused(tmp_path: Path) -> None:
    write_transforms(tmp_path / "walk", applied_scale=1e-300)
    with pytest.raises(InvalidTrajectory, match="implausibly far away"):
        read_recording(tmp_path / "walk")


def test_an_error_names_no_transforms_json_where_there_is_none(tmp_path: Path) -> None:
    write_transforms(tmp_path / "walk", fl_x="wide")
    (tmp_path / "walk" / "transforms.json").rename(tmp_path / "walk" / "transforms_train.json")
    with pytest.raises(InvalidCamera, match=r"^The transforms' fl_x is not a number"):
        read_recording(tmp_path / "walk")


def edit_metashape(folder: Path, *edits: tuple[str, str]) -> None:
    """The walk as Metashape's cameras.xml with texts replaced."""
    path = phone.write_recording("metashape", folder) / "cameras.xml"
    text = path.read_text()
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)


def without_transform(text: str) -> str:
    """The text of cameras.xml whose component has no transform."""
    start, end = text.index('<component id="0">'), text.index("</components>")
    return text[:start] + '<component id="0"/><component id="1"/>' + text[end:]


def test_metashapes_components_without_a_common_frame_are_not_mixed(tmp_path: Path) -> None:
    path = phone.write_recording("metashape", tmp_path / "walk") / "cameras.xml"
    text = without_transform(path.read_text())
    for number in range(5):
        camera = f'<camera id="{number}" sensor_id="0" component_id='
        text = text.replace(f'{camera}"0"', f'{camera}"1"')
    path.write_text(text)
    recording = read_recording(tmp_path / "walk")
    assert recording.frames.numbers.tolist() == list(range(5, phone.FRAMES))
    assert any("19 cameras of the largest component" in one for one in not_used(recording))
    assert not recording.poses.metric


def test_a_component_that_is_not_placed_itself_is_placed_by_its_chunk(tmp_path: Path) -> None:
    path = phone.write_recording("metashape", tmp_path / "walk") / "cameras.xml"
    text = path.read_text()
    start, end = text.index("<transform><rotation"), text.index("</component>")
    path.write_text(without_transform(text).replace("</chunk>", text[start:end] + "</chunk>"))
    poses = read_recording(tmp_path / "walk").poses
    assert poses.metric
    np.testing.assert_allclose(poses.T_map_camera, phone.camera_poses(phone.R_PORTRAIT_CAMERA_IMU), atol=1e-9)


def test_a_mask_is_not_taken_for_the_photo_of_its_name(tmp_path: Path) -> None:
    edit_metashape(tmp_path / "walk")
    phone.write_images(tmp_path / "walk" / "masks", ["DSC00003.png"])
    recording = read_recording(tmp_path / "walk")
    assert recording.frames.numbers.tolist() == [0, 1, 2, *range(4, phone.FRAMES)]
    assert any("DSC00003" in text and "label" in text for text in not_used(recording))
    phone.write_images(tmp_path / "walk" / "masks", [f"DSC{number:05d}.png" for number in range(phone.FRAMES)])
    with pytest.raises(InvalidRecording, match="shares its label with another camera or picture"):
        read_recording(tmp_path / "walk")


@pytest.mark.parametrize(("lens", "named"), [("frame", "b2, p3"), ("fisheye", "b2, p1, p2, p3")])
def test_coefficients_of_metashape_that_have_no_place_are_named(lens: str, named: str, tmp_path: Path) -> None:
    edit_metashape(
        tmp_path / "walk",
        ('type="frame"', f'type="{lens}"'),
        ("<k2>", "<b2>3</b2><p3>0.1</p3><p4>0</p4><k2>"),
    )
    recording = read_recording(tmp_path / "walk")
    assert recording.camera is not None
    (text,) = (one.text for one in recording.warnings if one.kind is WarningKind.CAMERA_UNSUPPORTED)
    assert f"The calibration's {named} cannot" in text


def test_a_photo_of_metashape_in_a_format_that_is_not_read_is_named(tmp_path: Path) -> None:
    edit_metashape(tmp_path / "walk")
    photo = tmp_path / "walk" / "photos" / "DSC00003.JPG"
    photo.rename(photo.with_suffix(".DNG"))
    with pytest.raises(InvalidRecording, match=r"DSC00003\.DNG is a DNG picture"):
        read_recording(tmp_path / "walk")
    photo.with_suffix(".DNG").unlink()
    with pytest.raises(InvalidRecording, match=r"no photo DSC00003\."):
        read_recording(tmp_path / "walk")


def test_several_chunks_of_metashape_are_refused(tmp_path: Path) -> None:
    edit_metashape(tmp_path / "walk", ("</document>", "<chunk><cameras/></chunk></document>"))
    with pytest.raises(InvalidRecording, match="several chunks"):
        read_recording(tmp_path / "walk")


def test_a_focal_length_of_zero_is_an_error_of_the_camera(tmp_path: Path) -> None:
    edit_metashape(tmp_path / "metashape", ("<f>61.0</f>", "<f>0</f>"), ("<b1>-1.0</b1>", ""))
    write_transforms(tmp_path / "nerfstudio", fl_x=0)
    for name in ("metashape", "nerfstudio"):
        with pytest.raises(InvalidCamera, match="a focal length is positive"):
            read_recording(tmp_path / name)


@pytest.mark.parametrize(
    ("model", "warned"), [("THIN_PRISM_FISHEYE, 64, 48, 60, 61, 32, 24", True), ("UNKNOWN_CAMERA, 64, 48", False)]
)
def test_a_model_of_kapture_that_is_not_supported_is_named(model: str, warned: bool, tmp_path: Path) -> None:
    sensors = phone.write_recording("kapture", tmp_path / "walk") / "sensors" / "sensors.txt"
    sensors.write_text(f"cam, , camera, {model}\n")
    recording = read_recording(tmp_path / "walk")
    assert recording.camera is None
    texts = [one.text for one in recording.warnings if one.kind is WarningKind.CAMERA_UNSUPPORTED]
    assert [model.split(",")[0] in text for text in texts] == [True] * warned


def test_the_rigs_in_kaptures_rigs_are_followed(tmp_path: Path) -> None:
    sensors = phone.write_recording("kapture", tmp_path / "walk") / "sensors"
    (sensors / "rigs.txt").write_text("robot, head, 1, 0, 0, 0, 0, 0, 1\nhead, cam, 1, 0, 0, 0, 0.5, 0, 0\n")
    path = sensors / "trajectories.txt"
    path.write_text(path.read_text().replace(", cam,", ", robot,"))
    poses = read_recording(tmp_path / "walk").poses
    expected = phone.camera_poses(phone.R_PORTRAIT_CAMERA_IMU)
    expected[:, :3, 3] -= expected[:, :3, :3] @ [0.5, 0, 1]
    np.testing.assert_allclose(poses.T_map_camera, expected, atol=1e-9)


def test_rigs_of_kapture_that_hold_each_other_end(tmp_path: Path) -> None:
    sensors = phone.write_recording("kapture", tmp_path / "walk") / "sensors"
    (sensors / "rigs.txt").write_text("a, b, 1, 0, 0, 0, 0, 0, 0\nb, a, 1, 0, 0, 0, 0, 0, 0\n")
    assert read_recording(tmp_path / "walk").poses.known.all()


def test_trajectories_of_kapture_without_a_picture_are_refused(tmp_path: Path) -> None:
    path = phone.write_recording("kapture", tmp_path / "walk") / "sensors" / "trajectories.txt"
    path.write_text(path.read_text().replace(", cam,", ", lidar,"))
    with pytest.raises(InvalidTrajectory, match="no pose of a picture"):
        read_recording(tmp_path / "walk")
