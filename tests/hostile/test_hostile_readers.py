"""Every reader of recordings, fed what nobody wrote down beforehand: it answers in one line, or reads it."""

from __future__ import annotations

import functools
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parents[1] / "recordings"))
sys.path.insert(0, str(Path(__file__).parents[1] / "jobs"))
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import phone_recordings as phone
from fake_pipeline import tiny_map

import fuzz_readers
from rholoc.errors import RholocError
from rholoc.evaluation.reading import read_frame_poses
from rholoc.geometry import Camera
from rholoc.maps import read_coefficient_table, write_coefficient_table
from rholoc.maps.formats.trajectory_table import PAPER_COLUMNS, read_trajectory_csv
from rholoc.recordings import RecordingFormat, read_imu_csv, read_recording

EXAMPLES = 40  # of each reader
LONGEST_COMPLAINT = 2000
STRANGE_VALUES = (
    "", "nan", "-inf", "1e999", "-1", "0", "1e308", "-1e-320", "9" * 400, "1_000", "0x10", "true", "null", '"', "[",
    "{}", "é", "\ud800", "\x00", "a" * 10_000, "[" * 100_000, "1,2,3", "..", "/etc/hostname", "１",
)  # fmt: skip


@functools.cache
def pristine(name: str) -> dict[str, bytes]:
    """The walk in a layout, with waypoints and a camera beside it: its files."""
    with tempfile.TemporaryDirectory() as folder:
        walk = phone.write_complete_recording(name, Path(folder) / "walk")
        return {str(path.relative_to(walk)): path.read_bytes() for path in walk.rglob("*") if path.is_file()}


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """A file after one thing has befallen it."""
    how = draw(st.sampled_from(["value", "line", "bytes", "cut", "grown", "other"]))
    at = draw(st.integers(0, max(0, len(content) - 1)))
    if how == "value":  # a number or a word becomes another
        text = content.decode("utf-8", "surrogateescape")
        separators = ',;: \t\n"[]{}'
        start = max((text.rfind(mark, 0, at) for mark in separators), default=-1) + 1
        end = min((found for mark in separators if (found := text.find(mark, start)) >= 0), default=len(text))
        changed = text[:start] + draw(st.sampled_from(STRANGE_VALUES)) + text[end:]
        return changed.encode("utf-8", "surrogatepass" if "\ud800" in changed else "surrogateescape")
    if how == "line":
        lines = content.split(b"\n")
        row = draw(st.integers(0, len(lines) - 1))
        return b"\n".join(
            draw(st.sampled_from([lines[:row] + lines[row + 1 :], lines[: row + 1] + lines[row:], lines[::-1]]))
        )
    if how == "bytes":
        return content[:at] + draw(st.binary(min_size=1, max_size=20)) + content[at + 1 :]
    if how == "cut":
        return content[:at]
    if how == "grown":
        return content + draw(st.sampled_from([content, b"\n\n", b"\xff\xfe", b"{", b","]))
    return draw(
        st.sampled_from(
            [b"", b"\n", b"[]", b"{}", b"null", b"\x00" * 100, b"," * 1000, b"[" * 100_000, b"\xef\xbb\xbf"]
        )
    )


def complaint_about(folder: Path) -> str:
    """Why a recording cannot be used, as far as reading it and its first picture show; nothing where it can."""
    try:
        recording = read_recording(folder)
        next(iter(recording.frames.images([0])))
    except RholocError as error:
        return f"{error.message} {error.hint}"
    return ""


def test_what_the_fuzzing_of_readers_damages_is_a_good_file_of_every_format(tmp_path):
    readers = fuzz_readers.readers()
    for number, reader in enumerate(readers):
        reader.read(fuzz_readers.write_files(reader.files, tmp_path / str(number)))
    written = {kind for kind, _ in phone.WRITERS.values()}
    assert written | {RecordingFormat.VIDEO} == set(RecordingFormat)
    assert {f"recording {layout}" for layout in phone.WRITERS} < {reader.name for reader in readers}


@pytest.mark.parametrize("name", phone.WRITERS)
def test_whatever_befalls_a_recording_it_is_read_or_refused_in_one_line(name):
    files = pristine(name)

    @settings(max_examples=EXAMPLES, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(st.data())
    def feed(data):
        broken = dict(files)
        for _ in range(data.draw(st.integers(1, 2))):
            victim = data.draw(st.sampled_from(sorted(broken)))
            broken[victim] = data.draw(damaged(files[victim]))
        with tempfile.TemporaryDirectory() as folder:
            for path, content in broken.items():
                (Path(folder) / path).parent.mkdir(parents=True, exist_ok=True)
                (Path(folder) / path).write_bytes(content)
            complaint = complaint_about(Path(folder))
        assert "\n" not in complaint
        assert len(complaint) < LONGEST_COMPLAINT

    feed()


@pytest.mark.parametrize("letters", ["a" * 300, "é" * 200, "folder/" + "b" * 250])
def test_a_name_that_no_file_can_have_is_refused(tmp_path: Path, letters: str) -> None:
    walk = phone.write_recording("tum", tmp_path / "walk")
    lines = (walk / "rgb.txt").read_text().splitlines()
    name = lines[-1].split()[1]
    (walk / "rgb.txt").write_text("\n".join(lines).replace(name, letters))
    assert "too long for a file" in complaint_about(walk)


@pytest.mark.parametrize("value", ["1e308", "-1e308", "9" * 300])
@pytest.mark.parametrize("column", [0, 4])
def test_numbers_too_large_for_a_pose_are_refused_without_a_warning(tmp_path: Path, value: str, column: int) -> None:
    row = ["0", "0", "0", "0", "0", "0", "0", "1"]
    row[column] = value
    header = ",".join([*PAPER_COLUMNS, "frame"])
    for name, text in (("poses.txt", " ".join(row)), ("t.csv", f"{header}\n{','.join(row)}")):
        (tmp_path / name).write_text(f"{text}\n")
        with warnings.catch_warnings(action="error"), pytest.raises(RholocError, match=r"poses\.txt|t\.csv"):
            read_frame_poses(tmp_path / name)


def test_lists_of_another_number_of_columns_are_refused(tmp_path: Path) -> None:
    walk = phone.write_recording("tum", tmp_path / "walk")
    for text in ("0.5\n0.6\n", "0.5 a.png 1\n"):
        (walk / "depth.txt").write_text(text)
        assert "Each row is a time and an image's name." in complaint_about(walk)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("mark", ["[", "("])
def test_brackets_that_none_closes_take_no_time(tmp_path: Path, mark: str) -> None:
    walk = phone.write_recording("tum", tmp_path / "walk")
    (walk / "depth.txt").write_text(f"# {mark * 2**20}\n0.5 a.png\n")
    assert complaint_about(walk) == ""


def test_a_sensor_file_of_euroc_is_plain_and_small(tmp_path: Path) -> None:
    walk = phone.write_recording("euroc", tmp_path / "walk")
    sensor = walk / "mav0" / "cam0" / "sensor.yaml"
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 8)}]" for i in range(1, 12)]  # 8**12 numbers
    sensor.write_text("\n".join([*lines, "T_BS: {data: *a11}"]))
    assert "is not plain YAML" in complaint_about(walk)
    sensor.write_text(f"T_BS: {{data: [{', '.join(['9' * 400] * 16)}]}}")
    assert complaint_about(walk) == ""
    sensor.write_text("#" * 2**16 + "\n")
    assert "larger than" in complaint_about(walk)
    sensor.write_text(f"distortion_model: {'x' * 10_000}\nintrinsics: [1, 1, 1, 1]\n")
    assert max(len(warning.text) for warning in read_recording(walk).warnings) < LONGEST_COMPLAINT


def test_a_focal_length_of_any_size_is_refused_without_a_warning() -> None:
    for focal in (1.7e308, 1e-320):
        with warnings.catch_warnings(action="error"), pytest.raises(RholocError, match="field of view"):
            Camera(640, 480, np.float64(focal), np.float64(focal), 320.0, 240.0)


@pytest.mark.parametrize("mark", ["\n", "\r", "\x1b[2J", "\x85", "\u2028", "\ud800"])
def test_an_error_that_quotes_a_value_is_one_line_and_steers_no_terminal(tmp_path: Path, mark: str) -> None:
    error = RholocError(f"'a{mark}b' is not a name.", f"Not{mark}so.")
    for text in (error.message, error.hint, str(error)):
        assert all(letter.isprintable() for letter in text)
    table = tmp_path / "imu.csv"
    table.write_text('timestamp,ax,ay,az,gx,gy,gz\n0,0,0,"1\n2",0,0,0\n')
    with pytest.raises(RholocError, match=r"'1 2' under az is not a finite number"):
        read_imu_csv(table)


def test_tables_do_not_repeat_a_wrong_value_of_any_length(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    table.write_text(f"{','.join(PAPER_COLUMNS)}\n{','.join(['x' * 10_000] * len(PAPER_COLUMNS))}\n")
    with pytest.raises(RholocError, match=r"row 2: 'x+' under \w+ is not a number") as refused:
        read_trajectory_csv(table)
    assert len(str(refused.value)) < LONGEST_COMPLAINT
    write_coefficient_table(tiny_map(), table)
    header, *rows = table.read_text().splitlines()
    table.write_text("\n".join([header.replace("a_0_0_0_0_0_1", "y" * 10_000), *rows]))
    with pytest.raises(RholocError, match=r"has the unexpected y+") as refused:
        read_coefficient_table(table)
    assert len(str(refused.value)) < LONGEST_COMPLAINT
