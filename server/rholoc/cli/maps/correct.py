"""``rholoc map correct``: corrects a map by what people know about the place."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rholoc.cli import options
from rholoc.cli.console import print_json, print_notice
from rholoc.errors import InvalidInput

if TYPE_CHECKING:
    from rholoc.geometry import FloatArray
    from rholoc.maps import Map

app = typer.Typer(
    no_args_is_help=True, help="Correct a map by what you know about the place; see `map info` for the result."
)

Out = Annotated[Path | None, typer.Option("--out", "-o", metavar="MAP.rho", help="Where to; default: the map itself.")]
Direction = Annotated[str, typer.Option(metavar="X,Y,Z", help="A direction in the map's present frame.")]
Level = Annotated[
    str | None, typer.Option(metavar="NAME", help="Level of an IMDF archive; default: the only one it has.")
]
Outline = Annotated[str, typer.Option(metavar="'X Y, X Y, …'", help="Corners seen from above, m: three or more.")]


@app.command()
def origin(
    map_file: options.MapFile,
    at: Annotated[str, typer.Option(metavar="X,Y,Z", help="The point that becomes the origin, present frame.")],
    out: Out = None,
    as_json: options.Json = False,
) -> None:
    """Move the map's origin."""
    from rholoc.mapping.edit.correcting import set_origin

    _correct(map_file, out, as_json, lambda map_: set_origin(map_, _vector(at, 3)))


@app.command()
def north(map_file: options.MapFile, direction: Direction, out: Out = None, as_json: options.Json = False) -> None:
    """Turn the map about z so that a direction becomes y."""
    from rholoc.mapping.edit.correcting import set_north

    _correct(map_file, out, as_json, lambda map_: set_north(map_, _vector(direction, 3)))


@app.command()
def wall(map_file: options.MapFile, direction: Direction, out: Out = None, as_json: options.Json = False) -> None:
    """Turn the map about z so that a direction, along a wall, becomes x."""
    from rholoc.mapping.edit.correcting import set_wall

    _correct(map_file, out, as_json, lambda map_: set_wall(map_, _vector(direction, 3)))


@app.command()
def up(
    map_file: options.MapFile,
    direction: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="What becomes z; default: as the map's views hold upright.")
    ] = None,
    out: Out = None,
    as_json: options.Json = False,
) -> None:
    """Set the map upright."""
    from rholoc.mapping.edit.correcting import set_up

    _correct(map_file, out, as_json, lambda map_: set_up(map_, None if direction is None else _vector(direction, 3)))


@app.command()
def scale(
    map_file: options.MapFile,
    start: Annotated[str, typer.Option(metavar="X,Y,Z", help="One end of a measured distance, present frame.")],
    end: Annotated[str, typer.Option(metavar="X,Y,Z", help="The other end.")],
    length: Annotated[float, typer.Option(metavar="METRES", min=0, help="The measured distance.")],
    out: Out = None,
    as_json: options.Json = False,
) -> None:
    """Correct the map's scale by a measured distance; the map is metric from then on."""
    from rholoc.mapping.edit.correcting import set_distance

    _correct(map_file, out, as_json, lambda map_: set_distance(map_, _vector(start, 3), _vector(end, 3), length))


@app.command()
def plan(
    map_file: options.MapFile,
    pair: Annotated[
        list[str], typer.Option(metavar="X,Y,Z=X,Y", help="A point of the map and where it is on the plan, m; repeat.")
    ],
    scaled: Annotated[bool, typer.Option("--scaled", help="Take on the plan's scale too.")] = False,
    out: Out = None,
    as_json: options.Json = False,
) -> None:
    """Align the map with a floor plan, whose frame becomes the map's."""
    import numpy as np

    from rholoc.mapping.edit.correcting import lay_over_plan

    sides = [one.partition("=") for one in pair]
    points = np.array([_vector(left, 3) for left, _, _ in sides])
    places = np.array([_vector(right, 2) for _, _, right in sides])
    _correct(map_file, out, as_json, lambda map_: lay_over_plan(map_, points, places, scaled))


@app.command()
def region(
    map_file: options.MapFile,
    outline: Outline,
    keep: Annotated[str, typer.Option(metavar="inside|outside", help="Which landmarks stay.")],
    bottom: Annotated[
        float | None, typer.Option(metavar="METRES", help="The region's lowest z; default: none.")
    ] = None,
    top: Annotated[float | None, typer.Option(metavar="METRES", help="Its highest z; default: none.")] = None,
    out: Out = None,
    as_json: options.Json = False,
) -> None:
    """Remove the landmarks inside a region, or all others."""
    from rholoc.mapping.edit.correcting import remove_region

    if keep not in ("inside", "outside"):
        raise InvalidInput(f"--keep is '{keep}'.", "Give inside or outside.")
    _correct(
        map_file,
        out,
        as_json,
        lambda map_: remove_region(map_, _corners(outline), bottom, top, keep_inside=keep == "inside"),
    )


@app.command()
def walk(
    map_file: options.MapFile,
    first: Annotated[int, typer.Option(metavar="VIEW", help="The first view to remove, by number from 0.")],
    last: Annotated[int, typer.Option(metavar="VIEW", help="The last one.")],
    out: Out = None,
    as_json: options.Json = False,
) -> None:
    """Remove a piece of the walk, and what only it saw."""
    from rholoc.mapping.edit.correcting import remove_views

    _correct(map_file, out, as_json, lambda map_: remove_views(map_, first, last))


@app.command()
def names(
    map_file: options.MapFile,
    point: Annotated[
        list[str] | None, typer.Option(metavar="NAME=X,Y,Z", help="Name a point, or move one; repeat.")
    ] = None,
    area: Annotated[
        list[str] | None, typer.Option(metavar="NAME='X Y, X Y, …'", help="Name an area, or redraw one; repeat.")
    ] = None,
    remove: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Remove a name; repeat.")] = None,
    kind: Annotated[
        list[str] | None, typer.Option(metavar="NAME=KIND", help="Kind of a named point or area; repeat.")
    ] = None,
    geojson: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, metavar="FILE", help="Points and areas: GeoJSON or an IMDF archive."),
    ] = None,
    level: Level = None,
    out: Out = None,
    as_json: options.Json = False,
) -> None:
    """Name points and areas; answers say which the camera is in or near. Other names stay."""
    from dataclasses import replace

    from rholoc.mapping.edit.correcting import set_names
    from rholoc.maps import MapNames, NamedArea, NamedPoint
    from rholoc.maps.floor_plan import ARCHIVE, media_type_of
    from rholoc.maps.formats.geojson import names_from_geojson
    from rholoc.maps.formats.plan_files import level_of_archive

    def named(map_: Map) -> Map:
        points = {one.name: one for one in map_.info.names.points}
        areas = {one.name: one for one in map_.info.names.areas}
        if geojson is not None:
            content = geojson.read_bytes()
            if media_type_of(content) == ARCHIVE:
                content = level_of_archive(content, level)
            given = names_from_geojson(content, map_.info.earth)
            points |= {one.name: one for one in given.points}
            areas |= {one.name: one for one in given.areas}
        for name in remove or ():
            if points.pop(name, None) is None and areas.pop(name, None) is None:
                raise InvalidInput(f"Nothing is named {name}.", "`rholoc map info` lists the names.")
        for name, _, place in (one.partition("=") for one in point or ()):
            x, y, z = _vector(place, 3).tolist()
            points[name] = replace(points.get(name, NamedPoint(name, (x, y, z))), position=(x, y, z))
        for name, _, corners in (one.partition("=") for one in area or ()):
            outline = tuple((x, y) for x, y in _corners(corners).tolist())
            areas[name] = replace(areas.get(name, NamedArea(name, outline)), outline=outline)
        for name, _, word in (one.partition("=") for one in kind or ()):
            if name not in points and name not in areas:
                raise InvalidInput(f"Nothing is named {name}.", "`rholoc map info` lists the names.")
            if name in points:
                points[name] = replace(points[name], kind=word)
            if name in areas:
                areas[name] = replace(areas[name], kind=word)
        return set_names(map_, MapNames(tuple(points.values()), tuple(areas.values())))

    _correct(map_file, out, as_json, named)


@app.command("floor-plan")
def floor_plan(
    map_file: options.MapFile,
    plan_file: Annotated[
        Path,
        typer.Argument(
            exists=True,
            dir_okay=False,
            metavar="PLAN",
            help="A picture, GeoJSON, an IMDF archive, or the yaml of a map_server.",
        ),
    ],
    at: Annotated[
        str | None, typer.Option(metavar="X,Y", help="Of the lower left corner; default: as the file says, else 0,0.")
    ] = None,
    turn: Annotated[float | None, typer.Option(metavar="DEG", help="Of the lower edge, from x towards y.")] = None,
    m_per_unit: Annotated[
        float | None, typer.Option(metavar="M", help="How long a pixel is; default: as the file says, else 1.")
    ] = None,
    level: Level = None,
    out: Out = None,
    as_json: options.Json = False,
) -> None:
    """Keep a floor plan with the map; the map does not move."""
    from rholoc.mapping.edit.correcting import set_floor_plan
    from rholoc.maps.formats.plan_files import PlanPlacement, packed_yaml, read_plan

    is_yaml = plan_file.suffix.lower() in (".yaml", ".yml")
    content = packed_yaml(plan_file) if is_yaml else plan_file.read_bytes()
    x, y = (None, None) if at is None else _vector(at, 2).tolist()
    placement = PlanPlacement(x, y, turn, m_per_unit)
    _correct(
        map_file,
        out,
        as_json,
        lambda map_: set_floor_plan(map_, *read_plan(content, None, level, placement, map_.info.earth)),
    )


@app.command()
def earth(
    map_file: options.MapFile,
    point: Annotated[
        list[str],
        typer.Option(metavar="X,Y,Z=LAT,LON,H", help="A point of the map and its place, WGS 84, degrees, m; repeat."),
    ],
    crs: Annotated[
        str | None,
        typer.Option(metavar="EPSG", help="Of a national grid: places are E,N,H. With heights' code: EPSG:25833+7837."),
    ] = None,
    heading: Annotated[
        float | None,
        typer.Option(
            metavar="DEG", help="Of the map's y axis from true north, clockwise; default: as the points give it."
        ),
    ] = None,
    out: Out = None,
    as_json: options.Json = False,
) -> None:
    """Place the map on Earth by points: at least two, or one with --heading. Its frame stays."""
    import numpy as np

    from rholoc.geometry.earth import EarthPlace, places_in
    from rholoc.mapping.edit.correcting import set_earth

    sides = [one.partition("=") for one in point]
    points = np.array([_vector(left, 3) for left, _, _ in sides])
    given = np.array([_vector(right, 3) for _, _, right in sides])
    places = [EarthPlace(*one) for one in given.tolist()] if crs is None else places_in(crs, given)
    _correct(map_file, out, as_json, lambda map_: set_earth(map_, points, places, heading))


@app.command()
def labels(
    map_file: options.MapFile,
    site: Annotated[str | None, typer.Option(help="Such as a building; default: as it was.")] = None,
    floor: Annotated[str | None, typer.Option(help="Of the site; default: as it was.")] = None,
    tag: Annotated[
        list[str] | None, typer.Option(help="A tag; together they replace those that it had; repeat.")
    ] = None,
    out: Out = None,
    as_json: options.Json = False,
) -> None:
    """Set the map's site, floor and tags, by which lists are grouped and searched."""
    from rholoc.mapping.edit.correcting import set_labels
    from rholoc.maps import MapLabels

    def labelled(map_: Map) -> Map:
        known = map_.info.labels
        return set_labels(
            map_,
            MapLabels(
                known.site if site is None else site,
                known.floor if floor is None else floor,
                known.tags if tag is None else tuple(tag),
            ),
        )

    _correct(map_file, out, as_json, labelled)


def _correct(map_file: Path, out: Path | None, as_json: bool, corrected: Callable[[Map], Map]) -> None:
    """Load a map, write its next version to ``out`` or over itself, and print what was corrected."""
    from rholoc.maps import load_map, save_map
    from rholoc.maps.info import info_to_json

    map_ = corrected(load_map(map_file))
    target = out or map_file
    save_map(map_, target)
    done: dict[str, Any] = json.loads(info_to_json(map_.info))["corrections"][-1]
    if as_json:
        print_json(done)
    else:
        print_notice(f"{target}: version {map_.info.version}, {done['kind']} corrected, {len(map_)} landmarks.")


def _vector(text: str, count: int) -> FloatArray:
    """``count`` coordinates (count,) from numbers separated by commas or spaces. Raises InvalidInput: the text is
    something else.
    """
    import numpy as np

    try:
        numbers = np.array([float(part) for part in text.replace(",", " ").split()])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise InvalidInput(
            f"'{text}' is not {count} coordinates.", "Write them as " + "1.2,0.4,0"[: 4 * count - 1] + "."
        )
    return numbers


def _corners(text: str) -> FloatArray:
    """Corners (N, 2) of an outline, "x y, x y, …". Raises InvalidInput: the text is something else."""
    import numpy as np

    return np.array([_vector(corner, 2) for corner in text.split(",")])
