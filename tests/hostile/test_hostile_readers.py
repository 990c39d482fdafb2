"""Every reader of recordings, fed what nobody wrote down beforehand: it answers in one line, or reads it."""

from __future__ import annotations

import functools
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parents[1] / "recordings"))
sys.path.insert(0, str(Path(__file__).parents[1] / "jobs"))
import phone_recordings as phone
from fake_pipeline import tiny_map

from rholoc.errors import RholocError
from rholoc.maps import read_coefficient_table, write_coefficient_table
from rholoc.maps.trajectory_table import PAPER_COLUMNS, read_trajectory_csv
from rholoc.recordings import CameraFile, read_recording, write_camera_json

EXAMPLES = 40  # of each reader
LONGEST_COMPLAINT = 2000
WAYPOINTS = "name,time,x,y,z\nA,1000.1,0,0,1.5\nB,1000.5,1,0,1.5\nC,1001.0,1,1,1.5\n"
STRANGE_VALUES = (
    "", "nan", "-inf", "1e999", "-1", "0", "1e308", "-1e-320", "9" * 400, "1_000", "0x10", "true", "null", '"', "[",
    "{}", "é", "\ud800", "\x00", "a" * 10_000, "[" * 100_000, "1,2,3", "..", "/etc/hostname", "１",
)  # fmt: skip


@functools.cache
def pristine(name: str) -> dict[str, bytes]:
    """The walk in a layout, with waypoints and a camera beside it: its files."""
    with tempfile.TemporaryDirectory() as folder:
        walk = phone.write_recording(name, Path(folder) / "walk")
        if not (walk / "waypoints.csv").exists():
            (walk / "waypoints.csv").write_text(WAYPOINTS)
        if not (walk / "camera.json").exists():
            write_camera_json(walk / "camera.json", CameraFile(fps=20.0, readout_s=0.01))
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
