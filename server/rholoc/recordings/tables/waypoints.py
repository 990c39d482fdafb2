"""``waypoints.csv``: measured points of the walk."""

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rholoc.errors import InvalidWaypoints
from rholoc.geometry.earth import EarthPlace, enu_of, places_in
from rholoc.recordings.recording import FrameSource, Waypoint
from rholoc.recordings.tables.csv_table import parse_number, read_rows, require_columns, shortened

EARTH_COLUMNS = ("lat", "lon", "h")
MIN_WAYPOINTS = 3
MAX_WAYPOINTS = 1000
MAX_NAME_LENGTH = 100
DEFAULT_SIGMA_M = 0.02
MIN_SIGMA_M, MAX_SIGMA_M = 0.001, 1.0
MIN_SPREAD_RATIO = 0.02  # spread across the best-fitting line over spread along it

_MAX_APART_M = 10_000.0
_TIME_DIGIT_S = 1e-6  # of the times that are written, which may therefore lie outside the recording by as much
_NAMES_SHOWN = 5
_COLUMNS_HINT = (
    "The first row must be name,time,x,y,z or name,frame,x,y,z: seconds or a frame's number, metres; or name,x,y,z, "
    "the rows in the order of the walk, where the camera paused at each; or lat,lon,h instead of x,y,z, or x,y,z,crs."
)


def read_waypoints_csv(path: Path, frames: FrameSource) -> tuple[Waypoint, ...]:
    """Read waypoints under the header ``name,time,x,y,z``, ``name,frame,x,y,z``, or ``name,x,y,z`` (in walking order).

    With ``lat,lon,h`` (WGS 84, degrees and metres) instead of ``x,y,z`` they are placed on Earth. A further column
    ``crs`` names the reference system of coordinates on Earth, as :func:`places_in` takes it.

    A further column ``sigma`` is the standard deviation of each coordinate in metres; 0.02 if absent or empty.

    Times up to a microsecond outside the recording are moved to its first or last frame, because tables are rounded.

    The waypoints may be collinear; :func:`check_waypoints_fix_frame` checks whether they fix a frame.

    Raises:
        NotInstalled: the reference system needs a package that is missing.
        InvalidInput: the reference system is unknown.
        InvalidWaypoints: other columns, several reference systems, fewer than three, more than 1000, an empty, repeated
            or overlong name, a value that is not finite, a sigma not 0.001 to 1 m, places over 10 km apart, a time
            outside the recording, a frame that is not in it, or times although the pictures have none.
    """
    header, rows = read_rows(path, InvalidWaypoints, MAX_WAYPOINTS)
    moment = next((column for column in ("time", "frame") if column in header), None)
    coordinates = EARTH_COLUMNS if "lat" in header else ("x", "y", "z")
    if moment is None and not {"name", *coordinates} <= set(header):
        raise InvalidWaypoints(f"{path.name} has other columns: '{shortened(','.join(header))}'.", _COLUMNS_HINT)
    if moment != "frame" and not frames.timed:
        raise InvalidWaypoints(
            f"{path.name} does not say in which picture each waypoint is, and the pictures have no times.",
            "Use the columns name,frame,x,y,z, or add frames.csv with the pictures' times.",
        )
    require_columns(path, header, ("name", *([moment] if moment else []), *coordinates), InvalidWaypoints)
    waypoints = tuple(_waypoint(row, line, moment, coordinates, path, frames) for line, row in enumerate(rows, start=2))
    systems = {row["crs"] for row in rows if row.get("crs")}
    if len(systems) > 1:
        raise InvalidWaypoints(f"{path.name} names {_listed(sorted(systems))} under crs.", "Use one for all waypoints.")
    if systems or coordinates == EARTH_COLUMNS:
        waypoints = _on_earth(waypoints, coordinates, *systems)
    _require_enough(waypoints)
    counted = Counter(waypoint.name for waypoint in waypoints)
    repeated = sorted(name for name, count in counted.items() if count > 1)
    if repeated:
        raise InvalidWaypoints(f"{path.name} names {_listed(repeated)} more than once.", "Give each its own name.")
    return waypoints


def write_waypoints_csv(path: Path, waypoints: Sequence[Waypoint]) -> None:
    """Write waypoints under the header ``name,time,x,y,z``: microseconds, tenths of a millimetre.

    Without times if they are unknown; with ``sigma`` if any differs from the default. Places on Earth are not written.
    """
    ordered = any(np.isnan(waypoint.time) for waypoint in waypoints)
    usual = all(waypoint.sigma_m == DEFAULT_SIGMA_M for waypoint in waypoints)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("name", *(() if ordered else ("time",)), "x", "y", "z", *(() if usual else ("sigma",))))
        for waypoint in waypoints:
            time = () if ordered else (f"{waypoint.time:.6f}",)
            sigma = () if usual else (f"{waypoint.sigma_m:.4f}",)
            writer.writerow((waypoint.name, *time, *(f"{value:.4f}" for value in waypoint.position), *sigma))


def check_waypoints_fix_frame(waypoints: Sequence[Waypoint]) -> None:
    """Check that the waypoints fix position, rotation and scale of a frame: three or more, not on one line.

    They count as collinear if the second singular value of their centred positions is below 2 % of the largest.

    Raises:
        InvalidWaypoints: fewer than three, all in one place, or collinear.
    """
    _require_enough(waypoints)
    positions = np.array([waypoint.position for waypoint in waypoints])
    along, across, _ = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    if across <= MIN_SPREAD_RATIO * along:
        names = _listed([waypoint.name for waypoint in waypoints])
        raise InvalidWaypoints(
            f"The waypoints {names} lie on one line: they leave the rotation about it open.",
            "Measure one more, well off that line.",
        )


def _listed(names: Sequence[str]) -> str:
    """Names for a message, separated by commas; of more than five, five and how many more."""
    return ", ".join(names[:_NAMES_SHOWN]) + (f" and {len(names) - _NAMES_SHOWN} more" if names[_NAMES_SHOWN:] else "")


def _require_enough(waypoints: Sequence[Waypoint]) -> None:
    """Raise InvalidWaypoints for fewer than three."""
    if len(waypoints) < MIN_WAYPOINTS:
        raise InvalidWaypoints(
            f"{len(waypoints)} waypoints; a frame needs at least {MIN_WAYPOINTS}.",
            "Measure three or more that do not lie on one line, or leave the waypoints out.",
        )


def _on_earth(waypoints: Sequence[Waypoint], columns: Sequence[str], crs: str | None = None) -> tuple[Waypoint, ...]:
    """Waypoints whose positions are places on Earth under these columns, in metres east, north and up of the first one.
    ``crs`` names another reference system than WGS 84. Raises InvalidWaypoints if one is off the Earth or over 10 km
    away.
    """
    if crs is None:
        places = [EarthPlace(*waypoint.position) for waypoint in waypoints]
    else:
        order = [1, 0, 2] if columns == EARTH_COLUMNS else [0, 1, 2]
        places = places_in(crs, np.array([waypoint.position for waypoint in waypoints])[:, order])
    if any(abs(place.latitude_deg) > 90 or abs(place.longitude_deg) > 180 for place in places):
        raise InvalidWaypoints("A waypoint has no place on Earth.", "Give lat of -90 to 90°, lon of -180 to 180°.")
    placed = []
    for waypoint, place in zip(waypoints, places, strict=True):
        east, north, up = enu_of(place, places[0]).tolist()
        if max(map(abs, (east, north, up))) > _MAX_APART_M:
            raise InvalidWaypoints(
                f"Waypoint {waypoint.name} is over 10 km from the first.", "Check their coordinates."
            )
        placed.append(replace(waypoint, position=(east, north, up), earth=place))
    return tuple(placed)


def _waypoint(
    row: dict[str, str], line: int, moment: str | None, coordinates: Sequence[str], path: Path, frames: FrameSource
) -> Waypoint:
    """Waypoint of a row: its time by the column ``moment`` (None: NaN), its position by ``coordinates``, as written."""
    name = row["name"]
    if not name:
        raise InvalidWaypoints(f"{path.name}, row {line}: the waypoint has no name.")
    if len(name) > MAX_NAME_LENGTH or not name.isprintable():
        raise InvalidWaypoints(
            f"{path.name}, row {line}: '{shortened(name)}' is not a valid waypoint name.",
            f"Use at most {MAX_NAME_LENGTH} printable characters.",
        )
    x, y, z = (parse_number(row[column], path, line, column, InvalidWaypoints) for column in coordinates)
    sigma_m = _sigma_m(row, line, path)
    if moment is None:
        return Waypoint(name, float("nan"), (x, y, z), sigma_m)
    when = parse_number(row[moment], path, line, moment, InvalidWaypoints)
    time = _time_of_frame(name, when, frames) if moment == "frame" else when
    first, last = float(frames.times[0]), float(frames.times[-1])
    if not first - _TIME_DIGIT_S <= time <= last + _TIME_DIGIT_S:
        raise InvalidWaypoints(
            f"Waypoint {name} is at {time:.3f} s, outside the recording's {first:.3f} to {last:.3f} s.",
            "Times must be on the recording's own clock.",
        )
    return Waypoint(name, min(max(time, first), last), (x, y, z), sigma_m)


def _sigma_m(row: dict[str, str], line: int, path: Path) -> float:
    """The row's ``sigma`` [m], 0.02 if absent or empty. Raises InvalidWaypoints unless it is 0.001 to 1 m."""
    if not row.get("sigma"):
        return DEFAULT_SIGMA_M
    sigma_m = parse_number(row["sigma"], path, line, "sigma", InvalidWaypoints)
    if not MIN_SIGMA_M <= sigma_m <= MAX_SIGMA_M:
        raise InvalidWaypoints(
            f"{path.name}, row {line}: sigma is {sigma_m:g}; it must be {MIN_SIGMA_M:g} to {MAX_SIGMA_M:g} m.",
            "Give how well the camera was held to the point, in metres: 0.02 is what a careful hand does.",
        )
    return sigma_m


def _time_of_frame(name: str, number: float, frames: FrameSource) -> float:
    """Time [s] of the frame with this number. Raises InvalidWaypoints."""
    rows = np.flatnonzero(frames.numbers == number)
    if len(rows) == 0:
        raise InvalidWaypoints(
            f"Waypoint {name} is at frame {number:g}, which does not exist in the recording.",
            f"Its frames are {frames.numbers[0]} to {frames.numbers[-1]}.",
        )
    return float(frames.times[rows[0]])
