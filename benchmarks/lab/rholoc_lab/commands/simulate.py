"""``rholoc simulate``: a simulated recording of a phone."""

from pathlib import Path
from typing import Annotated

import typer

from rholoc.cli import options
from rholoc.cli.console import fraction_progress, print_notice


def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The folder to write the recording to.")],
    light: Annotated[str, typer.Option(metavar="daylight|artificial|dim", help="How the room is lit.")] = "artificial",
    seconds: Annotated[float, typer.Option(min=1, max=600, help="The recording's length.")] = 30.0,
    seed: options.Seed = 0,
    walk: Annotated[int, typer.Option(min=1, help="Which walk through the site; all share one map frame.")] = 1,
    site: Annotated[
        str,
        typer.Option(
            metavar="room|building", help="A room, or two storeys of corridors, look-alike doors, 14 rooms and stairs."
        ),
    ] = "room",
    fps: Annotated[float, typer.Option(min=1, max=60, help="Frames a second of the video.")] = 30.0,
) -> None:
    """Simulate a walk through a room or a building: video, IMU, waypoints, and the true poses in truth.csv."""
    from rholoc.simulation import Light
    from rholoc_lab.simulation.sites import Site, simulate_site

    chosen = options.choice(Light, light, "--light")
    where = options.choice(Site, site, "--site")
    with fraction_progress(f"walk {walk}") as progress:
        recording = simulate_site(out, where, walk, seconds, seed, light=chosen, fps=fps, progress=progress)
    print_notice(f"{len(recording.times)} frames in {out}; their true poses are in {recording.truth}.")
