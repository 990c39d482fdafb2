"""``rholoc map density``: a map's densities as pictures, films and volumes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli import options
from rholoc.cli.console import print_notice
from rholoc.errors import InvalidInput

if TYPE_CHECKING:
    from rholoc.maps import Map
    from rholoc.paper.density_localizer import Ascent
    from rholoc.paper.landscape import Look

_FILM_FPS = 5.0
_MAX_SHOTS = 40  # of a film along the views that saw a feature
_SHARPENING = (3, 5, 10, 30, 100)
_BEARING_SIGMA_PX = 1.5


def density(
    map_file: options.MapFile,
    feature: Annotated[int | None, typer.Option(metavar="N", help="Whose density; features count from 0.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="FRAME", help="The product of what a picture shows, and the way up to it.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="A .png, a film (.gif, .mp4), or a volume (.vti)."),
    ] = None,
    view: Annotated[
        int | None, typer.Option(metavar="K", help="Seen from which view of the map; default: one that saw it.")
    ] = None,
    pixel: Annotated[
        str | None, typer.Option(metavar="U,V", help="Seen at which pixel; default: where it appears.")
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option(min=0.5, max=1000, help="Its width, px; default: 60 at a focal length of 525.")
    ] = None,
    sharpening: Annotated[
        bool, typer.Option("--sharpening", help="How it sharpens from 3 observations to all that there are.")
    ] = False,
    starts: Annotated[int, typer.Option(min=1, max=20, help="--picture: from how many places to climb.")] = 4,
    camera: options.Camera = None,
) -> None:
    """Show a feature's density over the picture, positions and headings; or how a picture is localized by it."""
    from rholoc.disk import replace_file
    from rholoc.maps import load_map
    from rholoc_lab.pictures.film import FILM_ENDINGS

    if (feature is None) == (picture is None):
        raise typer.BadParameter("Give either --feature N or --picture FRAME.", param_hint="--feature")
    endings = (".png",) if sharpening else (".png", ".vti", *FILM_ENDINGS)
    target = out or map_file.with_name(f"{map_file.stem}-density.png")
    ending = target.suffix.lower()
    if ending not in endings:
        raise InvalidInput(f"'{target.name}' does not end in {' or '.join(endings)}.", "Rename the file.")
    map_ = load_map(map_file)
    if picture is not None:
        content = _picture(map_, picture, camera, starts, ending)
    else:
        assert feature is not None
        content = _feature(map_, feature, view, pixel, tolerance, sharpening, ending)
    replace_file(target, content)
    print_notice(f"{target}: {target.stat().st_size} bytes.")


def _feature(
    map_: Map,
    feature: int,
    view: int | None,
    pixel: str | None,
    tolerance_px: float | None,
    sharpening: bool,
    ending: str,
) -> bytes:
    import numpy as np

    from rholoc.density.density import TARGET_RADIUS
    from rholoc.paper.landscape import over_positions, seen_from
    from rholoc_lab.paper.vti import image_data
    from rholoc_lab.pictures.density import feature_frames, feature_grid, feature_png
    from rholoc_lab.pictures.film import film

    if not 0 <= feature < len(map_):
        raise InvalidInput(f"The map has no feature {feature}.", f"Its features are 0 to {len(map_) - 1}.")
    if sharpening:
        return _sharpening(map_, feature)
    saw = np.unique(map_.observations.views[map_.observations.features == feature])
    if view is None:
        view = int(saw[len(saw) // 2]) if len(saw) else 0
    if not 0 <= view < len(map_.views):
        raise InvalidInput(f"The map has no view {view}.", f"Its views are 0 to {len(map_.views) - 1}.")
    width = TARGET_RADIUS * map_.info.camera.focal if tolerance_px is None else tolerance_px
    look = _look(map_, feature, view, pixel)
    title = f"feature {feature}, {map_.info.density}"
    if ending == ".png":
        return feature_png(map_, look, width, f"{title}: ρ seen from view {view}")
    if ending == ".vti":
        grid = feature_grid(map_, look)
        may_be_seen = seen_from(map_, feature, grid).astype(np.float64)
        fields = {"rho": over_positions(map_, look, grid, width), "may_be_seen": may_be_seen}
        return image_data(grid.origin, (grid.spacing_m,) * 3, fields)
    chosen = saw[np.unique(np.linspace(0, len(saw) - 1, min(_MAX_SHOTS, len(saw))).astype(np.int64))]
    looks = [_look(map_, feature, int(one), pixel) for one in chosen]
    return film(feature_frames(map_, looks, width, title), ending, _FILM_FPS)


def _look(map_: Map, feature: int, view: int, pixel: str | None) -> Look:
    from dataclasses import replace

    import numpy as np

    from rholoc.paper.landscape import Look

    look = Look.of_view(map_, feature, view)
    if pixel is not None:
        try:
            u, v = (float(part) for part in pixel.split(","))
        except ValueError:
            u = v = float("nan")
        if not (np.isfinite(u) and np.isfinite(v)):
            raise InvalidInput(f"'{pixel}' is not a pixel.", "Give it as 320,240.")
        return replace(look, pixel=np.array([u, v]))
    if not np.isfinite(look.pixel).all():
        raise InvalidInput(f"Feature {feature} is behind the camera of view {view}.", "Omit --view, or give --pixel.")
    return look


def _sharpening(map_: Map, feature: int) -> bytes:
    import numpy as np

    from rholoc.mapping.build.stored_observations import observed_rays
    from rholoc_lab.pictures.density import sharpening_png

    rays = observed_rays(map_)
    rows = np.flatnonzero(rays.features == feature)
    if len(rows) < _SHARPENING[0]:
        raise InvalidInput(f"Feature {feature} was observed {len(rows)} times; that is too few.", "Choose another.")
    counts = [count for count in _SHARPENING if count < len(rows)] + [len(rows)]
    sigma_rad = _BEARING_SIGMA_PX / map_.info.camera.focal
    title = f"feature {feature}: its density as observations come"
    return sharpening_png(rays.bearings[rows], rays.positions[rows], sigma_rad, counts, title)


def _picture(map_: Map, picture: Path, camera: str | None, starts: int, ending: str) -> bytes:
    from rholoc.paper.density_localizer import TOLERANCES_PX
    from rholoc.paper.landscape import Grid, product_over_positions
    from rholoc_lab.paper.vti import image_data
    from rholoc_lab.pictures.density import ascent_frames, ascent_png
    from rholoc_lab.pictures.film import film

    ascents = _ascents(map_, picture, camera, starts)
    if ending == ".png":
        return ascent_png(map_, ascents, picture.name)
    if ending == ".vti":
        best = ascents[-1]
        T = best.optimum.T_map_camera
        grid = Grid.about(T[:3, 3], (0.5, 0.5, 0.5), 0.05)
        values = product_over_positions(map_, best.evidence, T, grid, TOLERANCES_PX[2])
        return image_data(grid.origin, (grid.spacing_m,) * 3, {"gain_nats": values})
    return film(ascent_frames(map_, ascents, picture.name), ending, _FILM_FPS)


def _ascents(map_: Map, picture: Path, camera: str | None, starts: int) -> list[Ascent]:
    """The ascents of a picture, the best last."""
    from rholoc.features import get_extractor
    from rholoc.geometry import Camera
    from rholoc.paper.density_localizer import DensityLocalizer
    from rholoc.recordings import read_image

    if not picture.is_file():
        raise InvalidInput(f"There is no picture {picture}.", "Check the path.")
    image = read_image(picture)
    height, width = image.shape[:2]
    named = options.named_camera(camera)
    if named is None:
        used = map_.info.camera.fitted(width, height)
    else:
        used = named.fitted(width, height) if isinstance(named, Camera) else Camera.parse(str(named), width, height)
    features = get_extractor(map_.info.features).extract(image)
    found = sorted(DensityLocalizer(map_, starts).ascents(features, used), key=lambda ascent: ascent.optimum.value)
    if not found:
        raise InvalidInput(f"{picture.name} shows too little that the map knows.", "Give a picture of this place.")
    return found
