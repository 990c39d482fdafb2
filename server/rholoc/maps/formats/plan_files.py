"""Floor plans as other programs write them: IMDF archives, and pictures with the yaml of ROS's ``map_server``."""

import io
import json
import lzma
import math
import struct
import zipfile
import zlib
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import yaml
from PIL import Image, ImageOps

from rholoc.disk import is_system_file
from rholoc.errors import InvalidInput
from rholoc.geometry.earth import EarthPlace, enu_of
from rholoc.maps.floor_plan import ARCHIVE, GEOJSON, MAX_PIXELS, FloorPlan, media_type_of
from rholoc.maps.formats.geojson import features_of, plain_label, positions_of, read_geojson
from rholoc.maps.sites import SiteOnEarth

_MAX_EXPANDED_BYTES = 64 * 2**20
_MAX_FILES, _ENTRY = 1000, b"PK\x01\x02"  # of an archive's directory
_MAX_YAML_BYTES = 2**14
_DRAWN = ("level", "unit", "section", "fixture", "kiosk", "opening", "detail")  # feature types of IMDF with walls
_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    EOFError,
    OSError,
    OverflowError,
    RuntimeError,
    ValueError,
)  # of zipfile
_YAML = (".yaml", ".yml")


@dataclass(frozen=True)
class PlanPlacement:
    """Requested pose of a floor plan; fields as in :class:`FloorPlan`, None if not given."""

    x: float | None = None
    y: float | None = None
    turn_deg: float | None = None
    m_per_unit: float | None = None

    def applied(self, plan: FloorPlan) -> FloorPlan:
        """The plan with the given fields in place of its own; a field that is None keeps the plan's value."""
        x, y = plan.corner
        return FloorPlan(
            plan.media_type,
            (x if self.x is None else self.x, y if self.y is None else self.y),
            plan.turn_deg if self.turn_deg is None else self.turn_deg,
            plan.m_per_unit if self.m_per_unit is None else self.m_per_unit,
        )


def plan_of_archive(content: bytes, level: str | None) -> tuple[bytes, FloorPlan]:
    """A floor plan from a ZIP archive: of IMDF, as GeoJSON; or of a yaml of ``map_server`` and its picture, as PNG.

    Args:
        content: the archive.
        level: of IMDF, by name, short name, ordinal or id; None: the only one.

    Returns:
        Content of the plan's file, and its pose: a picture's from the yaml, GeoJSON's at the map's origin.

    Raises:
        InvalidInput: it is neither, something is missing or damaged, or the level is not clear.
    """
    with _opened(content) as archive:
        names = _names(archive)
        config = next((name for name in names if PurePosixPath(name).suffix in _YAML), None)
        if config is None:
            collection = _level_features(archive, level)
            return json.dumps(collection, separators=(",", ":")).encode(), FloorPlan(GEOJSON, (0.0, 0.0), 0.0, 1.0)
        settings = _settings(_member(archive, config, _MAX_YAML_BYTES))
        wanted = PurePosixPath(str(settings["image"])).name
        picture = next((name for name in names if PurePosixPath(name).name == wanted), None)
        if picture is None:
            raise InvalidInput(f"The archive has no {wanted[:60]}, which its yaml names.", "Pack both files.")
        return _placed_picture(_member(archive, picture, _MAX_EXPANDED_BYTES), settings)


def level_of_archive(content: bytes, level: str | None) -> bytes:
    """The features of a level of an IMDF archive that can be drawn, without the level's outline, as a GeoJSON
    FeatureCollection. ``level`` is a name, short name, ordinal or id; None: the only one.

    Raises:
        InvalidInput: it is not IMDF, is damaged or too large, or no or several levels match.
    """
    with _opened(content) as archive:
        collection = _level_features(archive, level, (*_DRAWN[1:], "amenity", "anchor"))
    return json.dumps(collection).encode()


def read_plan(
    content: bytes, media_type: str | None, level: str | None, placement: PlanPlacement, earth: SiteOnEarth | None
) -> tuple[bytes, FloorPlan]:
    """Content and pose of a floor plan, in the form that a map stores.

    Args:
        content: a picture, GeoJSON, or an archive of :func:`plan_of_archive`.
        media_type: of the content; None to detect it from the first bytes.
        level: of an IMDF archive.
        placement: requested pose. Its None fields are taken from the yaml, else they are 0 (``m_per_unit``: 1). GeoJSON
            without ``x``, ``y`` and ``turn_deg`` is placed by its longitude and latitude if ``earth`` is known.
        earth: the map's pose on Earth, if known.

    Raises:
        InvalidInput: the archive is unusable, or GeoJSON has no longitude and latitude. Pictures are not checked here.
    """
    kind = media_type or media_type_of(content)
    plan = FloorPlan(kind, (0.0, 0.0), 0.0, 1.0)
    if kind == ARCHIVE:
        content, plan = plan_of_archive(content, level)
    free = placement.x is None and placement.y is None and placement.turn_deg is None
    if plan.media_type == GEOJSON and earth is not None and free:
        plan = _on_earth(content, plan, earth)
    return content, placement.applied(plan)


def packed_yaml(path: Path) -> bytes:
    """A ``map_server`` yaml and the picture that it names, relative to the yaml, as a zip archive for
    :func:`plan_of_archive`.

    Raises:
        InvalidInput: one of the files cannot be read, or the yaml is not one of map_server.
    """
    packed = io.BytesIO()
    try:
        text = path.read_bytes()
        picture = path.parent / str(_settings(text)["image"])
        with zipfile.ZipFile(packed, "w", strict_timestamps=False) as archive:
            archive.writestr(path.name, text)
            archive.write(picture, picture.name)
    except OSError as error:
        raise InvalidInput(f"{error.filename} cannot be read: {error.strerror}.", "Put both files there.") from error
    return packed.getvalue()


def _on_earth(content: bytes, plan: FloorPlan, earth: SiteOnEarth) -> FloorPlan:
    """The plan with its pose, by the GeoJSON's south-western corner. Raises InvalidInput if it is not in WGS 84."""
    positions = np.array(list(positions_of(read_geojson(content))))
    if len(positions) == 0 or not (np.abs(positions) <= (180, 90)).all():
        raise InvalidInput("The floor plan has no longitude and latitude.", "Send lines or areas of WGS 84.")
    west, south = positions.min(axis=0).tolist()
    corner = enu_of(EarthPlace(south, west, earth.height_m), earth.origin)
    x, y, _ = (earth.R_enu_site.T @ corner).tolist()
    return replace(plan, corner=(x, y), turn_deg=earth.heading_deg)


def _opened(content: bytes) -> zipfile.ZipFile:
    """The archive. Raises InvalidInput if it is damaged or too large."""
    if content.count(_ENTRY) > _MAX_FILES:  # before they are parsed, which takes much memory
        raise InvalidInput(f"The archive holds more than {_MAX_FILES} files.", "Pack the plan alone.")
    try:
        archive = zipfile.ZipFile(io.BytesIO(content))
    except _DAMAGED as error:
        raise InvalidInput("The floor plan is not a ZIP archive.", "Send it as it was written.") from error
    if sum(one.file_size for one in archive.infolist()) > _MAX_EXPANDED_BYTES:
        raise InvalidInput(
            f"The archive holds more than {_MAX_EXPANDED_BYTES // 2**20} MB.", "Leave out other levels or pictures."
        )
    return archive


def _names(archive: zipfile.ZipFile) -> list[str]:
    """Names of an archive's files, without those that operating systems add."""
    return [name for name in archive.namelist() if not is_system_file(PurePosixPath(name))]


def _member(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    """Content of a file in the archive. Raises InvalidInput if it is damaged or longer than ``max_bytes``."""
    try:
        with archive.open(name) as file:
            content = file.read(max_bytes + 1)
    except _DAMAGED as error:
        raise InvalidInput(f"{name[:60]} of the archive cannot be read.", "Pack it again.") from error
    if len(content) > max_bytes:
        raise InvalidInput(f"{name[:60]} of the archive is longer than {max_bytes} bytes.", "Send a smaller one.")
    return content


def _settings(text: bytes) -> dict[str, Any]:
    """``image``, ``origin`` (x, y, yaw [rad]), ``resolution`` [m per pixel]. Raises InvalidInput if one is missing."""
    try:
        settings = yaml.safe_load(text)
        x, y, yaw = (float(value) for value in settings["origin"])
        resolution = float(settings["resolution"])
        if (
            not isinstance(settings["image"], str)
            or not all(map(math.isfinite, (x, y, yaw, resolution)))
            or resolution <= 0
        ):
            raise ValueError
    except (yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise InvalidInput(
            "The yaml is not one of map_server.", "It needs image, resolution, and origin: [x, y, yaw]."
        ) from error
    return {**settings, "origin": (x, y, yaw), "resolution": resolution}


def _placed_picture(picture: bytes, settings: dict[str, Any]) -> tuple[bytes, FloorPlan]:
    """A picture of ``map_server`` as PNG with dark walls, and its pose. Raises InvalidInput if broken or too large."""
    try:
        with Image.open(io.BytesIO(picture)) as image:
            if image.width * image.height > MAX_PIXELS:
                raise InvalidInput(f"The floor plan has {image.width}×{image.height} pixels.", "Send a smaller one.")
            grey = image.convert("L")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InvalidInput("The archive's picture cannot be read.", "Send PGM, PNG or BMP.") from error
    written = io.BytesIO()
    (ImageOps.invert(grey) if settings.get("negate") else grey).save(written, "PNG")
    x, y, yaw = settings["origin"]
    return written.getvalue(), FloorPlan("image/png", (x, y), math.degrees(yaw), settings["resolution"])


def _level_features(archive: zipfile.ZipFile, level: str | None, kinds: tuple[str, ...] = _DRAWN) -> dict[str, Any]:
    """FeatureCollection of a level's features of the given types of IMDF. Raises InvalidInput if no or several levels
    match. ``level`` is a name, short name, ordinal or id; None is the only level.
    """
    files = {PurePosixPath(name).name: name for name in _names(archive)}
    if "level.geojson" not in files:
        raise InvalidInput(
            "The archive is neither IMDF nor a picture with its yaml.", "IMDF has level.geojson and unit.geojson."
        )

    def read(kind: str) -> list[dict[str, Any]]:
        name = files.get(f"{kind}.geojson")
        return [] if name is None else features_of(read_geojson(_member(archive, name, _MAX_EXPANDED_BYTES)))

    levels = {str(one.get("id")): one.get("properties") or {} for one in read("level")}
    called = {key: _level_names(key, properties) for key, properties in levels.items()}
    chosen = [key for key, names in called.items() if level is None or level in names]
    if len(chosen) != 1:
        known = ", ".join(names[0] for names in called.values())[:200]
        raise InvalidInput("Which level of the archive is not clear.", f"Name one of them with level: {known}.")
    features = [
        one
        for kind in kinds
        for one in read(kind)
        if chosen[0] in (str(one.get("id")), str((one.get("properties") or {}).get("level_id")))
    ]
    return {"type": "FeatureCollection", "features": [one for one in features if one.get("geometry")]}


def _level_names(key: str, properties: dict[str, Any]) -> list[str]:
    """Texts by which a level may be named: short name, name, ordinal and, last, its id ``key``."""
    names = [plain_label(properties.get(member)) for member in ("short_name", "name", "ordinal")]
    return [*dict.fromkeys(name for name in names if name), key]
