"""``rholoc backup`` and ``rholoc restore``: all that a server cannot make again, in one file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli.console import print_json, print_notice
from rholoc.cli.operate.serve import Data, Maps, service_settings
from rholoc.cli.options import Json

if TYPE_CHECKING:
    from rholoc.library.stores import Stores
    from rholoc.service import Settings
    from rholoc.service.operate.backup import Manifest
from dataclasses import asdict

from rholoc.cli.console import fraction_progress, output
from rholoc.errors import InvalidInput

_MB = 1e6


def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Where to; it must not exist.")],
    recordings: Annotated[bool, typer.Option("--recordings", help="Recordings, too; they are large.")] = False,
    maps: Maps = None,
    data: Data = None,
    as_json: Json = False,
) -> None:
    """Write maps, the versions that they replaced, sites, cameras and keys to a file; the server may run."""
    from rholoc.service.operate.backup import back_up

    with _opened(service_settings(maps_dir=maps, data_dir=data)) as stores:
        manifest = back_up(file, stores, recordings)
    _say("Backed up", manifest, as_json)


def restore(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What rholoc backup wrote.")],
    maps: Maps = None,
    data: Data = None,
    as_json: Json = False,
) -> None:
    """Restore a backup, except maps whose files are damaged. If anything in it exists already and differs, nothing is
    restored.
    """
    from rholoc.service.operate.backup import restore as bring_back

    with _opened(service_settings(maps_dir=maps, data_dir=data)) as stores:
        manifest, moved = bring_back(file, stores)
    for name in moved.unreadable:
        print_notice(f"The current version of the map {name} was not restored, for its file is damaged.")
    _say("Restored", manifest, as_json)


@contextmanager
def _opened(settings: Settings) -> Iterator[Stores]:
    """Yield the service's stores, opened; closed at the end of the block."""
    stores = settings.stores()
    try:
        stores.open()
        yield stores
    finally:
        stores.close()


def _say(done: str, manifest: Manifest, as_json: bool) -> None:
    """Print the numbers of a backup's files by kind, after the word ``done``; or as JSON."""
    figures = {
        "maps": manifest.count("maps/*.rho"),
        "versions": manifest.count("maps/.previous/*"),
        "sites": manifest.count("maps/sites/*"),
        "cameras": manifest.count("maps/cameras/*"),
        "keys": manifest.count("data/keys/*"),
        "recordings": manifest.count("data/recordings/*/.entry.json"),
        "size_bytes": sum(one.size_bytes for one in manifest.files.values()),
    }
    if as_json:
        print_json(figures)
        return
    counts = ", ".join(f"{count} {what}" for what, count in figures.items() if what != "size_bytes")
    print_notice(f"{done}: {counts}; {figures['size_bytes'] / _MB:.1f} MB.")


storage_app = typer.Typer(help="Bring what a server has into a storage that several share.", no_args_is_help=True)


@storage_app.callback()
def _group() -> None:
    pass


@storage_app.command("import")
def import_folders(maps: Maps = None, data: Data = None, as_json: Json = False) -> None:
    """Copy maps, cameras, sites, keys and recordings from this server's folders into RHOLOC_STORAGE_URL."""
    from rholoc.library.data_import import import_data

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
        print_notice(f"The current version of the map {what} was not copied, for its file is damaged.")
    counts = ", ".join(f"{count} {kind}" for kind, count in asdict(moved).items() if kind not in ("left", "unreadable"))
    output.print(f"Imported {counts}. The folders stay as they are.", markup=False, soft_wrap=True)
