"""``rholoc map export`` and ``import``: maps for and from other programs."""

from pathlib import Path
from typing import Annotated

import typer

from rholoc.cli import options
from rholoc.cli.console import print_notice
from rholoc.cli.maps.build import save_and_print
from rholoc.errors import InvalidInput


def export(
    map_file: options.MapFile,
    to: Annotated[
        str,
        typer.Option(
            metavar="rho|csv|observations|trajectory|ply|vtp|gltf|surfaces|colmap|nerfstudio|geojson|png",
            help="CSV, observations, trajectory: Tables 5, 4 and 6; PLY, VTP: points, and surfaces: where densities "
            "peak, for ParaView; COLMAP, nerfstudio: cameras and poses; GeoJSON: named points and areas; PNG: a "
            "picture from above.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="Where to; default: the map's name.")
    ] = None,
    features: Annotated[
        str | None,
        typer.Option(metavar="N,A:B,…", help="Whose surfaces; default: the 500 seen most often."),
    ] = None,
    degree: Annotated[
        int | None, typer.Option(metavar="1|2|3", help="CSV of tensor densities fitted with this degree.")
    ] = None,
) -> None:
    """Write a map for other programs, or as a picture."""
    from rholoc.disk import replace_file
    from rholoc.exports import ExportFormat, export_map, parse_features
    from rholoc.maps import load_map

    form = options.choice(ExportFormat, to, "--to")
    chosen = None if features is None else parse_features(features)
    target = out or map_file.with_name(map_file.stem + form.ending)
    if target.resolve() == map_file.resolve():
        raise InvalidInput(f"{target} is the map itself.", "Export to another file.")
    map_ = load_map(map_file)
    replace_file(target, export_map(map_, form, title=map_file.stem, degree=degree, features=chosen))
    print_notice(f"{target}: {target.stat().st_size} bytes.")


def import_(
    table: Annotated[Path, typer.Argument(metavar="TABLE", help="A map as CSV (Table 5), as --to csv writes it.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="MAP.rho", help="Where to.")],
    as_json: options.Json = False,
) -> None:
    """Read a map from CSV. It localizes like the map that was written."""
    from rholoc.maps import read_coefficient_table

    save_and_print(read_coefficient_table(table), out, as_json)
