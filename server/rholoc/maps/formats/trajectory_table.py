"""Table 6: an estimated trajectory as CSV."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.disk import replace_file
from rholoc.errors import InvalidTrajectory
from rholoc.geometry import FloatArray, IntArray, PosedCameras, pose_matrix, rotation_from_heading
from rholoc.maps.map import Map
from rholoc.maps.trust import trust_of

PAPER_COLUMNS = ("timestamp", "x", "y", "z", "hx", "hy", "hz")
FURTHER_COLUMNS = ("frame", "roll", "qx", "qy", "qz", "qw", "confidence", "inliers", "map_trusted", "expected_error_m")
TRAJECTORY_COLUMNS = PAPER_COLUMNS + FURTHER_COLUMNS

_MAX_SHOWN = 80  # characters of a wrong value
_HINT = f"The first row must be {','.join(PAPER_COLUMNS)}, with or without {','.join(FURTHER_COLUMNS)} after it."
_NORM_TOLERANCE = 1e-2
_MAX_WHOLE = 2.0**53  # largest float range with all whole numbers


@dataclass(frozen=True, eq=False)
class TrajectoryTable(PosedCameras):
    """N localized frames; frames without a pose have no row.

    Attributes:
        times: (N,) float64, seconds on the recording's clock.
        frames: (N,) int64, frame numbers; -1 where unknown.
        T_map_camera: (N, 4, 4).
        confidences: (N,) float64, 0..1; NaN where unknown.
        inliers: (N,) int64; 0 where unknown.
        map_trusted: (N,) float64, whether the frame's map is to be trusted: 1, 0, or NaN if unknown. None if unknown
            for all.
        expected_errors_m: (N,) float64, expected RMS error of the frame's map there; NaN if unknown. None if unknown
            for all.
    """

    times: FloatArray
    frames: IntArray
    T_map_camera: FloatArray
    confidences: FloatArray
    inliers: IntArray
    map_trusted: FloatArray | None = None
    expected_errors_m: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.times)

    @property
    def rolls(self) -> FloatArray:
        """Rotations (N,) about the headings against the upright camera [rad], -π to π."""
        upright = np.reshape([rotation_from_heading(heading) for heading in self.headings], (-1, 3, 3))
        R = np.einsum("nij,nik->njk", upright, self.T_map_camera[:, :3, :3])
        return np.asarray(np.arctan2(R[:, 1, 0], R[:, 0, 0]))

    @property
    def quaternions_xyzw(self) -> FloatArray:
        """Quaternions (N, 4), x, y, z, w with w ≥ 0, of R_map_camera."""
        if len(self) == 0:
            return np.zeros((0, 4))
        quaternions = Rotation.from_matrix(self.T_map_camera[:, :3, :3]).as_quat()
        return np.asarray(np.where(quaternions[:, 3:] < 0, -quaternions, quaternions))


def view_trajectory(map_: Map) -> TrajectoryTable:
    """A map's views as a trajectory; frames and confidences are unknown, ``inliers`` count each view's observations."""
    views = len(map_.views)
    trusted = trust_of(map_.info).trusted
    return TrajectoryTable(
        times=map_.views.times,
        frames=np.full(views, -1),
        T_map_camera=map_.views.T_map_camera,
        confidences=np.full(views, np.nan),
        inliers=np.diff(map_.view_offsets).astype(np.int64),
        map_trusted=np.full(views, np.nan if trusted is None else float(trusted)),
        expected_errors_m=map_.views.expected_errors_m,
    )


def write_trajectory_csv(path: Path, table: TrajectoryTable) -> None:
    """Write Table 6: times to a microsecond, positions to 10 µm, directions to 1e-8.

    Raises:
        StorageFull: the disk is full; an existing file is unchanged.
        InvalidInput: the folder does not exist or cannot be written to.
    """
    replace_file(path, trajectory_csv(table).encode())


def trajectory_csv(table: TrajectoryTable) -> str:
    """The text of Table 6 with its header; unknown values are written as ``nan``."""
    values = np.column_stack(
        [
            table.times,
            table.positions,
            table.headings,
            table.frames,
            table.rolls,
            table.quaternions_xyzw,
            table.confidences,
            table.inliers,
            _or_unknown(table.map_trusted, len(table)),
            _or_unknown(table.expected_errors_m, len(table)),
        ]
    )
    formats = ["%.6f"] + ["%.5f"] * 3 + ["%.8f"] * 3 + ["%d", "%.8f"] + ["%.8f"] * 4 + ["%.4f", "%d", "%.0f", "%.5f"]
    text = io.StringIO()
    text.write(",".join(TRAJECTORY_COLUMNS) + "\n")
    np.savetxt(text, values, fmt=formats, delimiter=",")
    return text.getvalue()


def _or_unknown(values: FloatArray | None, count: int) -> FloatArray:
    """The values (N,) themselves; all NaN, ``count`` of them, if None."""
    return np.full(count, np.nan) if values is None else values


def read_trajectory_csv(path: Path) -> TrajectoryTable:
    """Read Table 6. The paper's seven columns suffice; without quaternions the camera is upright (or has ``roll``).

    Other missing columns: frames -1, confidences NaN, inliers 0, the rest None.

    Raises:
        InvalidTrajectory: the file cannot be read, a column is missing, a value is not a number, a time, position,
            heading or roll in use is not finite, a frame or inliers not whole, or a heading or quaternion not of unit
            length. A table without rows is a trajectory without poses.
    """
    header, values = _read_values(path)
    columns = {name: values[:, header.index(name)] for name in TRAJECTORY_COLUMNS if name in header}
    n = len(values)
    required = np.column_stack([columns[name] for name in PAPER_COLUMNS])
    if not np.isfinite(required).all():
        raise InvalidTrajectory(f"{path.name}: a time, position or heading is not a finite number.")
    return TrajectoryTable(
        times=columns["timestamp"],
        frames=_whole(columns.get("frame", np.full(n, -1.0)), "frame", path),
        T_map_camera=pose_matrix(_rotations(columns, path), required[:, 1:4]),
        confidences=columns.get("confidence", np.full(n, np.nan)),
        inliers=_whole(columns.get("inliers", np.zeros(n)), "inliers", path),
        map_trusted=columns.get("map_trusted"),
        expected_errors_m=columns.get("expected_error_m"),
    )


def _read_values(path: Path) -> tuple[list[str], FloatArray]:
    """The names of the known columns and their values (N, C). Raises InvalidTrajectory for a bad file or value."""
    try:
        rows = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8-sig"))))
    except OSError as error:
        raise InvalidTrajectory(f"{path.name} cannot be read: {error.strerror}.", "Check the path.") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidTrajectory(f"{path.name} is not a CSV table.", _HINT) from error
    header = [name.strip().lower() for name in rows[0]] if rows else []
    missing = [name for name in PAPER_COLUMNS if name not in header]
    if missing:
        raise InvalidTrajectory(f"{path.name} has no column {', '.join(missing)}.", _HINT)
    known = [name for name in header if name in TRAJECTORY_COLUMNS]
    body = [(line, row) for line, row in enumerate(rows[1:], start=2) if row]
    values = [_parse(row, line, header, path) for line, row in body]
    return known, np.array(values, dtype=np.float64).reshape(-1, len(known))


def _parse(row: Sequence[str], line: int, header: Sequence[str], path: Path) -> list[float]:
    """Values of the known columns, in the header's order. Raises InvalidTrajectory: one is no number, or missing."""
    if len(row) != len(header):
        raise InvalidTrajectory(f"{path.name}, row {line}: {len(row)} values under {len(header)} column names.")
    known = [(name, value) for name, value in zip(header, row, strict=True) if name in TRAJECTORY_COLUMNS]
    try:
        return [float(value) for _, value in known]
    except ValueError as error:
        name, value = next((name, value) for name, value in known if not _is_number(value))
        shown = value[:_MAX_SHOWN]
        raise InvalidTrajectory(f"{path.name}, row {line}: '{shown}' under {name} is not a number.") from error


def _is_number(text: str) -> bool:
    """Whether a text is a number, NaN and infinity included."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _whole(values: FloatArray, name: str, path: Path) -> IntArray:
    """The values (N,) of the column ``name`` as integers. Raises InvalidTrajectory if one is not whole or too large."""
    if not (np.abs(values) < _MAX_WHOLE).all() or np.any(values != np.floor(values)):
        raise InvalidTrajectory(f"{path.name}: a value under {name} is not a whole number, or too large.")
    return values.astype(np.int64)


def _rotations(columns: dict[str, FloatArray], path: Path) -> FloatArray:
    """R_map_camera (N, 3, 3), from quaternions where there are any, else from headings and rolls (0 without that
    column). Raises InvalidTrajectory if one is not of unit length (within 1 %), or a roll is not finite.
    """
    headings = np.column_stack([columns[name] for name in ("hx", "hy", "hz")])
    _require_unit(headings, "heading", path)
    if all(name in columns for name in ("qx", "qy", "qz", "qw")):
        quaternions = np.column_stack([columns[name] for name in ("qx", "qy", "qz", "qw")])
        _require_unit(quaternions, "quaternion", path)
        return Rotation.from_quat(quaternions).as_matrix() if len(quaternions) else np.zeros((0, 3, 3))
    rolls = columns.get("roll", np.zeros(len(headings)))
    if not np.isfinite(rolls).all():
        raise InvalidTrajectory(f"{path.name}: a roll is not a finite number.")
    rotations = [rotation_from_heading(heading, float(roll)) for heading, roll in zip(headings, rolls, strict=True)]
    return np.reshape(rotations, (-1, 3, 3)) if rotations else np.zeros((0, 3, 3))


def _require_unit(vectors: FloatArray, name: str, path: Path) -> None:
    """Raise InvalidTrajectory unless all vectors (N, C) are of unit length within 1 %."""
    norms = np.linalg.norm(vectors.clip(-2, 2), axis=1)  # squares of more may overflow, and are not of unit length
    if not np.all(np.abs(norms - 1) <= _NORM_TOLERANCE):
        raise InvalidTrajectory(f"{path.name}: a {name} is not of unit length.")
