"""``rholoc backup`` and ``rholoc restore``: all that a server cannot make again, in one file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli.console import print_json, print_notice
from rholoc.cli.options import Json
from rholoc.cli.serve import Data, Maps, service_settings
from rholoc.errors import InvalidInput

if TYPE_CHECKING:
    from rholoc.service import Settings
    from rholoc.service.backup import Manifest

_MB = 1e6


def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Where to; it must not exist.")],
    recordings: Annotated[bool, typer.Option("--recordings", help="Recordings, too; they are large.")] = False,
    maps: Maps = None,
    data: Data = None,
    as_json: Json = False,
) -> None:
    """Write maps, the versions that they replaced, sites, cameras and keys to a file; the server may run."""
    from rholoc.service.backup import back_up

    settings = _folders(maps, data)
    _say("Backed up", back_up(file, settings.maps_dir, settings.data_dir, recordings), as_json)


def restore(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What rholoc backup wrote.")],
    maps: Maps = None,
    data: Data = None,
    as_json: Json = False,
) -> None:
    """Bring back what is in a backup. Nothing is replaced: where something of it exists, nothing is restored."""
    from rholoc.service.backup import restore as bring_back

    settings = _folders(maps, data)
    _say("Restored", bring_back(file, settings.maps_dir, settings.data_dir), as_json)


def _folders(maps: Maps, data: Data) -> Settings:
    settings = service_settings(maps_dir=maps, data_dir=data)
    if settings.shared_storage is not None:
        raise InvalidInput(
            "This service keeps its maps in shared storage.", "Back up the database and the object storage themselves."
        )
    return settings


def _say(done: str, manifest: Manifest, as_json: bool) -> None:
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
