"""``rholoc audit``: who changed what on a server."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Annotated

import typer

from rholoc.cli.console import output, print_json, print_notice
from rholoc.cli.operate.serve import Data, service_settings
from rholoc.cli.options import Json


def audit(
    map_name: Annotated[str | None, typer.Option("--map", metavar="NAME", help="Changes of this map alone.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="How many at most, the newest first.")] = 100,
    data: Data = None,
    as_json: Json = False,
) -> None:
    """Show who changed what over HTTP: maps, sites, cameras, recordings, jobs, keys."""
    from rholoc.service.access.audit import AuditLog
    from rholoc.storage.database import open_database

    settings = service_settings(data_dir=data)
    engine = open_database(settings.data_dir, settings.jobs_database)
    changes = AuditLog(engine).changes(limit, map_name)
    engine.dispose()
    if as_json:
        print_json([asdict(change) for change in changes])
        return
    if not changes:
        print_notice("Nothing was changed over HTTP.")
    for change in changes:
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(change.time))
        job = f", job {change.job}" if change.job else ""
        output.print(f"{when}  {change.who}: {change.method} {change.path}{job}", markup=False, soft_wrap=True)
