"""Every reader, fed what nobody wrote down beforehand: it answers in one line, or reads it."""

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "recordings"))
sys.path.insert(0, str(Path(__file__).parents[1] / "jobs"))
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import phone_recordings as phone

import fuzz_readers
from fake_pipeline import tiny_map
from rholoc.errors import RholocError
from rholoc.evaluation.reading import read_frame_poses
from rholoc.geometry import Camera
from rholoc.maps import read_coefficient_table, write_coefficient_table
from rholoc.maps.formats.trajectory_table import PAPER_COLUMNS, read_trajectory_csv
from rholoc.recordings import RecordingFormat, read_imu_csv, read_recording

CASES = 15  # of each reader
LONGEST_COMPLAINT = fuzz_readers.MOST_CHARACTERS
READERS = {reader.name: reader for reader in fuzz_readers.readers()}


def complaint_about(folder: Path) -> str:
    """Why a recording cannot be used, as far as reading it and its first picture show; nothing where it can."""
    try:
        recording = read_recording(folder)
        next(iter(recording.frames.images([0])))
    except RholocError as error:
        return f"{error.message} {error.hint}"
    return ""


def test_what_the_fuzzing_of_readers_damages_is_a_good_file_of_every_format(tmp_path):
    for number, reader in enumerate(READERS.values()):
        reader.read(fuzz_readers.write_files(reader.files, tmp_path / str(number)))
    written = {kind for kind, _ in phone.WRITERS.values()}
    elsewhere = {RecordingFormat.BAG, RecordingFormat.KAPTURE}
    assert written | elsewhere | {RecordingFormat.VIDEO} == set(RecordingFormat)
    assert {f"recording {layout}" for layout in phone.WRITERS} < set(READERS)


@pytest.mark.parametrize("name", READERS)
def test_whatever_befalls_a_file_it_is_read_or_refused_in_one_line(name):
    tally = fuzz_readers.Tally()
    for number in range(CASES):
        fuzz_readers.run_case(READERS[name], number, 0, tally)
    assert tally.problems == []


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
