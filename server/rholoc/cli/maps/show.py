"""``rholoc map list``, ``info`` and ``report``: what maps say about themselves."""

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from rholoc.cli import options
from rholoc.cli.console import output, print_error, print_json, print_notice
from rholoc.cli.maps.page import map_figures, print_map, print_page, trust_line
from rholoc.errors import RholocError


def list_maps(
    maps: Annotated[
        Path | None,
        typer.Argument(metavar="DIR", help="The folder of maps; default: RHOLOC_MAPS_DIR or maps."),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Show the maps of a folder, whether they are to be trusted, and how far they expect to be off."""
    from rholoc.library.maps import MapLibrary
    from rholoc.maps import expected_error_m, trust_of

    folder = maps or Path(os.environ.get(options.MAPS_VARIABLE, options.DEFAULT_MAPS))
    library = MapLibrary(folder)
    rows: list[dict[str, Any]] = []
    for name in library.names():
        try:
            map_ = library.get(name)
        except RholocError as error:
            print_error(error.message, error.hint)
            continue
        trust = trust_of(map_.info)
        rows.append(
            {
                "name": name,
                "version": map_.info.version,
                "landmarks": len(map_),
                "views": len(map_.views),
                "trusted": trust.trusted,
                "trust_reason": trust.reason,
                "expected_error_m": expected_error_m(map_.info),
            }
        )
    if as_json:
        print_json(rows)
        return
    if not rows:
        print_notice(f"There are no maps in {folder}.")
    for row in rows:
        trusted = trust_line(row["trusted"], row["trust_reason"])
        expected_m = row["expected_error_m"]
        expected = "unknown" if expected_m is None else f"{100 * expected_m:.1f} cm"
        what = f"{row['landmarks']} landmarks, {row['views']} views, expected error {expected}"
        line = f"{row['name']}: {what}, trusted: {trusted}"
        output.print(line, markup=False, soft_wrap=True)


def info(map_file: options.MapFile, as_json: options.Json = False) -> None:
    """Print whether to trust a map, how large the room is, where the map works, and what to do better."""
    from rholoc.maps import load_map

    print_map(load_map(map_file), map_file, as_json)


def report(
    map_file: options.MapFile,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="PNG", help="Where to; default: the map's name.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Draw a map's report: where it works and where not, how consistent it is, how exact its landmarks are."""
    from rholoc.disk import replace_file
    from rholoc.maps import load_map
    from rholoc.pictures.map_report import report_png

    map_ = load_map(map_file)
    target = out or map_file.with_name(f"{map_file.stem}-report.png")
    replace_file(target, report_png(map_, map_file.stem))
    if as_json:
        print_json(map_figures(map_, map_file)["report"])
    else:
        print_page(map_, map_file)
        print_notice(f"{target} shows it.")
