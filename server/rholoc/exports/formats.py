"""Formats to which a map can be exported."""

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from enum import StrEnum
from itertools import chain
from pathlib import PurePath

import numpy as np

from rholoc.density import DensityKind
from rholoc.density.tensor import DEGREES
from rholoc.errors import InvalidInput
from rholoc.exports.reconstructions import colmap_model, nerfstudio_transforms
from rholoc.mapping.build.density_fitting import fit_densities, ray_form
from rholoc.maps import (
    Map,
    coefficient_table,
    map_surfaces_vtp,
    map_to_bytes,
    map_to_gltf,
    map_to_ply,
    map_to_vtp,
    observations_csv,
    trajectory_csv,
    view_trajectory,
)
from rholoc.maps.formats.geojson import names_to_geojson
from rholoc.maps.formats.surfaces import MAX_SURFACES
from rholoc.paper.observation_table import observation_table

_SURFACES = 500  # default number
_PIECE_BYTES = 2**18
_FEATURES = re.compile(r"([0-9]{1,9})(?::([0-9]{1,9}))?")


class ExportFormat(StrEnum):
    """Format of an export."""

    RHO = "rho"  # the native map
    CSV = "csv"  # Table 5: its densities' coefficients; reads back to the same map
    OBSERVATIONS = "observations"  # Table 4: what was seen from where
    TRAJECTORY = "trajectory"  # Table 6: its views
    PLY = "ply"  # landmarks and views, for MeshLab, CloudCompare, ParaView
    VTP = "vtp"  # the same for ParaView, with the view path as a line
    GLTF = "gltf"  # the same for the web, Blender and game engines, in one binary file
    SURFACES = "surfaces"  # where chosen densities peak, for ParaView
    COLMAP = "colmap"  # cameras, images and points as COLMAP's text model, in a ZIP file
    NERFSTUDIO = "nerfstudio"  # cameras and poses as transforms.json
    GEOJSON = "geojson"  # its named points and areas
    PNG = "png"  # a picture from above

    @property
    def ending(self) -> str:
        """The end of a file's name after the map's: ``.csv``, ``-observations.csv``."""
        match self:
            case ExportFormat.OBSERVATIONS | ExportFormat.TRAJECTORY:
                return f"-{self.value}.csv"
            case ExportFormat.SURFACES:
                return f"-{self.value}.vtp"
            case ExportFormat.GLTF:
                return ".glb"
            case ExportFormat.COLMAP:
                return "-colmap.zip"
            case ExportFormat.NERFSTUDIO:
                return "-transforms.json"
            case _:
                return f".{self.value}"

    @property
    def media_type(self) -> str:
        """Its media type in HTTP."""
        kinds = {
            ".csv": "text/csv",
            ".png": "image/png",
            ".vtp": "application/xml",
            ".glb": "model/gltf-binary",
            ".zip": "application/zip",
            ".json": "application/json",
            ".geojson": "application/geo+json",
        }
        return kinds.get(PurePath(f"map{self.ending}").suffix, "application/octet-stream")


def export_map(
    map_: Map,
    to: ExportFormat,
    *,
    title: str = "",
    degree: int | None = None,
    features: Sequence[int] | None = None,
) -> Iterator[bytes]:
    """Export a map; yields the file's content in pieces.

    Args:
        map_: the map.
        to: the format.
        title: the title of a ``PNG``.
        degree: for CSV: P of the ``tensor`` densities, equation (3), fitted for the export; None: the map's own.
        features: for surfaces: the features; None: the 500 that were seen most often.

    Raises:
        InvalidInput: an option is out of range or for another format, the map does not remember its observations, or
            the format cannot hold its camera.
        InvalidMap: the map is inconsistent.
    """
    if degree is not None and to is not ExportFormat.CSV:
        raise InvalidInput(f"A degree does not apply to {to}.", "Only csv takes one.")
    if features is not None and to is not ExportFormat.SURFACES:
        raise InvalidInput(f"Features cannot be chosen for {to}.", "Choose them for surfaces.")
    match to:
        case ExportFormat.RHO:
            return iter([map_to_bytes(map_)])
        case ExportFormat.CSV:
            return _pieces(coefficient_table(map_ if degree is None else _refitted(map_, degree)))
        case ExportFormat.OBSERVATIONS:
            return _pieces(observations_csv(observation_table(map_)))
        case ExportFormat.TRAJECTORY:
            return iter([trajectory_csv(view_trajectory(map_)).encode()])
        case ExportFormat.PLY:
            return iter([map_to_ply(map_)])
        case ExportFormat.VTP:
            return iter([map_to_vtp(map_)])
        case ExportFormat.GLTF:
            return iter([map_to_gltf(map_)])
        case ExportFormat.SURFACES:
            return iter([map_surfaces_vtp(map_, _most_seen(map_) if features is None else features)])
        case ExportFormat.COLMAP:
            return iter([colmap_model(map_)])
        case ExportFormat.NERFSTUDIO:
            return iter([nerfstudio_transforms(map_).encode()])
        case ExportFormat.GEOJSON:
            collection = names_to_geojson(map_.info.names, map_.info.earth)
            return iter([json.dumps(collection, ensure_ascii=False, indent=1).encode() + b"\n"])
        case ExportFormat.PNG:
            from rholoc.pictures.map_preview import preview_png

            return iter([preview_png(map_, title)])


def parse_features(text: str) -> list[int]:
    """Features of ``3,17,40:60``: numbers, and ranges without their ends, each cut after ``MAX_SURFACES`` + 1. A range
    that ends before it begins is empty.

    Raises:
        InvalidInput: the text is something else, such as a range without a begin or an end.
    """
    chosen: list[int] = []
    for part in text.split(","):
        match = _FEATURES.fullmatch(part.strip())
        if match is None:
            raise InvalidInput(
                f"'{text[:60]}' is not a valid selection of features.", "Give numbers and ranges: 3,17,40:60."
            )
        first = int(match[1])
        stop = first + 1 if match[2] is None else int(match[2])
        chosen += range(first, min(stop, first + MAX_SURFACES + 1))  # enough to see that there are too many
    return chosen


def _refitted(map_: Map, degree: int) -> Map:
    """The map with ``tensor`` densities of this degree. Raises InvalidInput for an impossible degree."""
    if degree not in DEGREES:
        raise InvalidInput(f"A density of degree {degree} cannot be fitted.", "Use 1, 2 or 3.")
    return fit_densities(ray_form(map_), DensityKind.TENSOR, degree)


def _most_seen(map_: Map) -> list[int]:
    """Numbers of the 500 features that most views see."""
    views = np.bincount(map_.observations.features, minlength=len(map_))
    chosen: list[int] = np.argsort(-views, kind="stable")[:_SURFACES].tolist()
    return chosen


def _pieces(lines: Iterator[str]) -> Iterator[bytes]:
    """Join lines to pieces of 256 KiB. Makes the first line immediately, to raise errors before any is written."""
    return _joined(chain([next(lines)], lines))


def _joined(lines: Iterable[str]) -> Iterator[bytes]:
    """Iterate over ASCII lines joined to pieces of at least 256 KiB; the last piece is what is left, maybe nothing."""
    piece = bytearray()
    for line in lines:
        piece += line.encode("ascii")
        if len(piece) >= _PIECE_BYTES:
            yield bytes(piece)
            piece.clear()
    yield bytes(piece)
