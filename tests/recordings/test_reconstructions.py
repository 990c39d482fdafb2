"""Models by other programs, as users have them: several models, other paths, other ways to state the intrinsics."""

from pathlib import Path

import phone_recordings as phone
import pytest

from rholoc.errors import InvalidRecording
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


def test_images_of_a_colmap_model_without_their_lines_of_points_are_refused(tmp_path: Path) -> None:
    path = phone.write_recording("colmap", tmp_path / "walk") / "sparse" / "0" / "images.txt"
    lines = [line for line in path.read_text().splitlines() if "walk/" in line or line.startswith("#")]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InvalidRecording, match=r"images\.txt: the line after walk/frame0023\.png"):
        read_recording(tmp_path / "walk")
