"""``rholoc backup`` and ``rholoc restore``: all that a server cannot make again, in one file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli.console import print_json, print_notice
from rholoc.cli.options import Json
from rholoc.cli.serve import Data, Maps, service_settings

if TYPE_CHECKING:
    from rholoc.service import Settings
    from rholoc.service.backup import Manifest
    from rholoc.storage import SharedStorage

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
    from rholoc.service.shared_backup import back_up_shared

    settings = service_settings(maps_dir=maps, data_dir=data)
    with _opened(settings) as shared:
        if shared is None:
            manifest = back_up(file, settings.maps_dir, settings.data_dir, recordings)
        else:
            manifest = back_up_shared(file, shared, settings.data_dir, recordings)
    _say("Backed up", manifest, as_json)


def restore(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What rholoc backup wrote.")],
    maps: Maps = None,
    data: Data = None,
    as_json: Json = False,
) -> None:
    """Bring back what is in a backup. Nothing is replaced: where something of it exists, nothing is restored."""
    from rholoc.service.backup import restore as bring_back
    from rholoc.service.shared_backup import restore_shared

    settings = service_settings(maps_dir=maps, data_dir=data)
    with _opened(settings) as shared:
        if shared is None:
            manifest = bring_back(file, settings.maps_dir, settings.data_dir)
        else:
            manifest = restore_shared(file, shared, settings.data_dir)
    _say("Restored", manifest, as_json)


@contextmanager
def _opened(settings: Settings) -> Iterator[SharedStorage | None]:
    """The storage that servers share, open; None where there is none."""
    from rholoc.service.app import open_shared

    shared = open_shared(settings)
    if shared is not None:
        shared.open()
    try:
        yield shared
    finally:
        if shared is not None:
            shared.close()


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
