"""``rholoc watch``: shows in Foxglove who is localized in a map of a service."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from rholoc.cli.console import print_notice
from rholoc.errors import RholocError
from rholoc.processes.interrupts import interruptible

KEY_VARIABLE = "RHOLOC_API_KEY"


def watch(
    map_name: Annotated[str, typer.Argument(metavar="MAP", help="Name of a map of the service.")],
    url: Annotated[str, typer.Option(help="The service.")] = "http://127.0.0.1:8080",
    view: Annotated[
        str, typer.Option(metavar="HOST[:PORT]", help="Where Foxglove connects to: ws://HOST:PORT.")
    ] = "127.0.0.1",
) -> None:
    """Show in Foxglove who is localized in a map of a service, until Ctrl-C. The key is in RHOLOC_API_KEY."""
    import numpy as np

    from rholoc.maps import load_map
    from rholoc.tracking.live_view import LiveView
    from rholoc_client import Client
    from rholoc_client.errors import RholocClientError

    try:
        with Client(url, os.environ.get(KEY_VARIABLE)) as client, LiveView(view, np.eye(4)) as shown:
            with TemporaryDirectory() as folder:
                path = Path(folder) / f"{map_name}.rho"
                path.write_bytes(client.download_map(map_name))
                landmarks = load_map(path).landmarks
            shown.room(0.0, landmarks.positions, landmarks.known_colours)
            print_notice(f"Foxglove: open a connection to ws://{view.rpartition(':')[0] or view}:{shown.port}.")
            with interruptible():
                for sightings in client.live(map_name):
                    for one in sightings:
                        if one["T_map_camera"] is not None:
                            shown.camera(one["time"], one["asker"], np.array(one["T_map_camera"]))
    except RholocClientError as error:
        raise RholocError(str(error)) from error
    except KeyboardInterrupt:
        print_notice("Stopped.")
