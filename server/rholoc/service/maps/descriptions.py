"""Descriptions of maps for clients."""

from pydantic import Field

from rholoc.errors import RholocError, UnknownMap
from rholoc.library.maps import MapLibrary
from rholoc.mapping.edit.frame_corrections import levelled
from rholoc.maps import (
    Correction,
    DensityKind,
    FloorPlan,
    Map,
    MapInfo,
    MapLabels,
    MapNames,
    MapOutline,
    MapWaypoint,
    SiteOnEarth,
    Source,
    consistency_m,
    expected_error_m,
    trust_of,
)
from rholoc.reports import MapReport
from rholoc.service.http.models import AnswerModel, CameraIn
from rholoc.trajectory import Scale


class MapSummary(AnswerModel):
    """A map in a list."""

    name: str
    id: str = Field(description="unique for each built map")
    version: int
    density: DensityKind
    features: str = Field(description="the extractor's name")
    scale: Scale
    upright: bool = Field(description="whether z points up")
    created: str = Field(description="when this version was made, ISO 8601, UTC")
    landmarks: int = Field(description="how many features it holds")
    views: int = Field(description="how many keyframes it was seen from")
    room: int = Field(description="how many vertices the surfaces of its room have; 0 until they are drawn")
    size_bytes: int
    trusted: bool | None = Field(
        description="whether the frame poses that it was built on passed every check; null where it does not say"
    )
    trust_reason: str = Field(description="why it is trusted, or which checks failed")
    expected_error_m: float | None = Field(
        description="how far its poses are expected to be from the truth, root mean square, m; null where unknown"
    )
    consistency_m: float | None = Field(
        description="median distance, m, between where frames of the walk that were held out of the map are localized "
        "and where the walk has them: how well the map agrees with itself, not how right it is; null if none were held "
        "out"
    )
    camera: CameraIn
    labels: MapLabels = Field(description="its site, floor and tags, as people set them")


class PreviousMap(AnswerModel):
    """The map that a map replaced."""

    number: int = Field(default=1, description="the number that restores it: 1 was replaced last")
    id: str
    version: int
    created: str = Field(description="ISO 8601, UTC")


class MapDetail(MapSummary):
    """A map with its sources and its extent."""

    sources: tuple[Source, ...]
    waypoints: tuple[MapWaypoint, ...]
    bounds_m: list[list[float]] | None = Field(description="the lowest and the highest x, y, z of its landmarks")
    previous: PreviousMap | None = Field(description="the map that it replaced, which can be restored")
    names: MapNames = Field(description="of points and areas")
    corrections: tuple[Correction, ...] = Field(description="what people corrected in it, the latest last")
    plan: FloorPlan | None = Field(
        description="the floor plan that it keeps, and where it lies; null where there is none"
    )
    earth: SiteOnEarth | None = Field(
        description="where its frame lies on Earth (WGS 84; heading of its y axis from true north); null where unknown"
    )
    points: int = Field(description="how many further points of the room it keeps, for people to see")
    pictures: bool = Field(description="whether it keeps pictures of its views, and this server shows them")
    levelling: list[list[float]] | None = Field(
        description="3×3, a rotation of the map for display that makes up z and walls parallel to x and y, both as "
        "estimated; null where the map is upright, or where up cannot be estimated"
    )
    keeps_refused: bool = Field(default=False, description="whether this server keeps refused pictures")
    live: bool = Field(default=False, description="whether this server shows who asks for poses in it")
    keeps_failures: bool = Field(default=False, description="whether this server keeps where requests fail in it")


class MapReportOut(AnswerModel):
    """What the map found out about itself while it was built."""

    map: str
    map_id: str
    map_version: int
    report: MapReport


class MapList(AnswerModel):
    """All maps that are served, by name; files that cannot be read are listed separately."""

    maps: list[MapSummary]
    unreadable: dict[str, str] = Field(description="names of map files that cannot be read, and why")


class MapVersions(AnswerModel):
    """The maps that a map replaced and that are kept, the latest first."""

    versions: list[PreviousMap]


def list_of(library: MapLibrary) -> MapList:
    """All maps of a library, by the headers of their files, and the names of unreadable files with the reason."""
    maps: list[MapSummary] = []
    unreadable: dict[str, str] = {}
    for name in library.names():
        try:
            fields = _fields(MapSummary, name, library.outline(name), library.stat(name).size_bytes)
            maps.append(MapSummary.model_validate(fields))
        except UnknownMap:
            continue  # deleted meanwhile
        except RholocError as error:
            unreadable[name] = error.message
    return MapList(maps=maps, unreadable=unreadable)


def versions_of(library: MapLibrary, name: str) -> MapVersions:
    """The maps that a map replaced. Raises InvalidName, UnknownMap."""
    library.stat(name)
    return MapVersions(versions=[_previous(number, info) for number, info in library.versions(name).items()])


def _fields(kind: type[MapSummary], name: str, outline: MapOutline, size_bytes: int) -> dict[str, object]:
    """Fields of a summary, and those fields of ``kind`` that the map's info has by the same name."""
    info = outline.info
    trust = trust_of(info)
    return {
        **{member: getattr(info, member) for member in kind.model_fields if hasattr(info, member)},
        "name": name,
        "scale": Scale.METRIC if info.metric else Scale.ARBITRARY,
        "landmarks": outline.landmarks,
        "views": outline.views,
        "room": outline.room,
        "size_bytes": size_bytes,
        "trusted": trust.trusted,
        "trust_reason": trust.reason,
        "expected_error_m": expected_error_m(info),
        "consistency_m": consistency_m(info),
        "camera": CameraIn(**info.camera.to_dict()),
    }


def detail_of(name: str, map_: Map, size_bytes: int, before: MapInfo | None) -> MapDetail:
    """Description of a map with a file of ``size_bytes`` bytes; ``before`` is the map that it replaced, or None."""
    bounds, rotation = None, levelled(map_)
    outline = MapOutline(map_.info, len(map_), len(map_.views), room=len(map_.room))
    if len(map_):
        bounds = [map_.landmarks.positions.min(axis=0).tolist(), map_.landmarks.positions.max(axis=0).tolist()]
    fields = {
        "bounds_m": bounds,
        "previous": None if before is None else _previous(1, before),
        "points": len(map_.cloud),
        "pictures": map_.views.pictures is not None,
        "levelling": None if rotation is None else rotation.tolist(),
    }
    return MapDetail.model_validate({**_fields(MapDetail, name, outline, size_bytes), **fields})


def _previous(number: int, info: MapInfo) -> PreviousMap:
    """A replaced map as it is sent; ``number`` restores it."""
    return PreviousMap(number=number, id=info.id, version=info.version, created=info.created)
