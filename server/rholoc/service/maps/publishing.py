"""Publish an uploaded map after a check that the service can use it."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from rholoc.errors import Conflict, InvalidInput, InvalidMap, NotInstalled, RholocError, TooLarge
from rholoc.features import get_extractor
from rholoc.library.maps import MapLibrary
from rholoc.localization import localizer_of
from rholoc.maps import Map, check_usable, is_coefficient_table, read_coefficient_table
from rholoc.service.maps.descriptions import MapReportOut, detail_of
from rholoc.service.settings import Settings


def publish_file(library: MapLibrary, name: str, arrived: Path, settings: Settings) -> None:
    """Publish a ``.rho`` file or a coefficient table (CSV) under a name, if the service's operations succeed on it.

    Raises:
        TooLarge, InvalidMap, InvalidInput, StorageUnavailable, StorageFull: nothing was replaced.
    """
    size_bytes, limit = arrived.stat().st_size, settings.max_map_bytes

    def check(map_: Map) -> None:
        _check_features(map_)
        _rehearse(map_, name, size_bytes, settings.min_recognized)

    if is_coefficient_table(arrived):
        map_ = read_coefficient_table(arrived, f"{name}.csv")
        check(map_)
        library.put(name, map_)
    elif size_bytes > limit:
        raise TooLarge(f"The map's file is longer than {limit} bytes.", "Split it, or raise RHOLOC_MAX_MAP_BYTES.")
    else:
        library.put_file(name, arrived, check)


def publish_merged(library: MapLibrary, parts: Mapping[str, Map], into: str, merged: Map) -> None:
    """Publish a merged map as ``into``. Raises Conflict if that is one of its parts and has changed meanwhile."""
    if into in parts and library.get(into) is not parts[into]:
        raise Conflict(f"The map {into} was changed in the meantime.", "Merge again.")
    library.put(into, merged)


def _check_features(map_: Map) -> None:
    """Raise InvalidMap unless the map's extractor is installed and its descriptors and channels are that one's."""
    hint = "Build the map with one of this version's extractors."
    try:
        extractor = get_extractor(map_.info.features)
    except NotInstalled as error:
        raise InvalidMap(error.message, error.hint) from error
    except InvalidInput as error:
        raise InvalidMap(error.message, hint) from error
    if (
        map_.descriptors.values.shape[1] != extractor.descriptor_bytes
        or not np.isin(map_.landmarks.channels, extractor.channels).all()
    ):
        raise InvalidMap(f"The map's descriptors are not '{extractor.name}' features.", hint)


def _rehearse(map_: Map, name: str, size_bytes: int, min_recognized: float) -> None:
    """Try the operations of later requests on a map. Raises InvalidMap: one failed, and the map must be refused."""
    check_usable(map_)
    try:
        detail_of(name, map_, size_bytes, None).model_dump_json()
        info = map_.info
        MapReportOut(map=name, map_id=info.id, map_version=info.version, report=info.report).model_dump_json()
        localizer_of(map_, min_recognized)
    except RholocError as error:
        raise InvalidMap(f"The map cannot be used: {error.message}", error.hint) from error
    except (ValueError, TypeError, ArithmeticError, LookupError, RecursionError) as error:
        raise InvalidMap(f"The map cannot be used: {error}.", "Build it again, or take another copy.") from error
