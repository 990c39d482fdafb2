"""``rholoc storage``: what several servers share."""

from __future__ import annotations

from dataclasses import asdict

import typer

from rholoc.cli.console import fraction_progress, output, print_json, print_notice
from rholoc.cli.operate.serve import Data, Maps, service_settings
from rholoc.cli.options import Json
from rholoc.errors import InvalidInput

app = typer.Typer(help="Bring what a server has into a storage that several share.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    pass


@app.command("import")
def import_folders(maps: Maps = None, data: Data = None, as_json: Json = False) -> None:
    """Copy maps, cameras, sites, keys and recordings from this server's folders into RHOLOC_STORAGE_URL."""
    from rholoc.library import import_data

    settings = service_settings(maps_dir=maps, data_dir=data)
    stores = settings.stores()
    if not stores.are_shared:
        raise InvalidInput("RHOLOC_STORAGE_URL is not set.", "Set it to the storage that the servers share.")
    stores.open()
    try:
        with fraction_progress("importing") as advance:
            moved = import_data(settings.maps_dir, settings.data_dir, stores, advance)
    finally:
        stores.close()
    if as_json:
        print_json(asdict(moved))
        return
    for what in moved.left:
        print_notice(f"Left, for the storage has it already: {what}")
    for what in moved.unreadable:
        print_notice(f"Left, for its file is damaged: {what}")
    counts = ", ".join(f"{count} {kind}" for kind, count in asdict(moved).items() if kind not in ("left", "unreadable"))
    output.print(f"Imported {counts}. The folders stay as they are.", markup=False, soft_wrap=True)
