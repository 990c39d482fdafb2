"""``rholoc key``: who may use a server that others can reach; ``rholoc audit``: who changed what on it."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli.console import output, print_json, print_notice
from rholoc.cli.operate.serve import Data, opened_keys, service_settings
from rholoc.cli.options import Json, choice

if TYPE_CHECKING:
    from rholoc.service.access.keys import KeyLimits, KeyStore


_DAY_S = 24 * 3600.0

app = typer.Typer(help="Make, limit, list and revoke the API keys of a server.", no_args_is_help=True)

Name = Annotated[str, typer.Argument(metavar="NAME", help="Whose key it is.")]
RequestsPerS = Annotated[
    float | None, typer.Option("--requests-per-s", min=0.001, help="Requests a second, to each server.")
]
Burst = Annotated[
    int | None, typer.Option("--burst", min=1, help="How many of them may come at once; default: those of a second.")
]
Maps = Annotated[int | None, typer.Option("--maps", min=0, help="How many maps it may hold.")]
StoredBytes = Annotated[
    int | None, typer.Option("--stored-bytes", min=0, help="How many bytes of maps and recordings it may hold.")
]
Jobs = Annotated[int | None, typer.Option("--jobs", min=0, help="How many of its jobs may be queued or running.")]


@app.command()
def create(
    name: Name,
    scope: Annotated[
        str,
        typer.Option(metavar="visit|read|localize|map|admin", help="What it allows; each includes the ones before."),
    ] = "localize",
    expires: Annotated[float | None, typer.Option(metavar="DAYS", min=0, help="How many days it is valid.")] = None,
    site: Annotated[str, typer.Option(metavar="SITE", help="Of a key to visit: the only site that it is for.")] = "",
    requests_per_s: RequestsPerS = None,
    burst: Burst = None,
    maps: Maps = None,
    stored_bytes: StoredBytes = None,
    jobs: Jobs = None,
    data: Data = None,
) -> None:
    """Make a key and print it. It is shown only once: the server only keeps its hash."""
    from rholoc.service.access.keys import KeyLimits, Scope

    wanted = choice(Scope, scope, "--scope")
    limits = KeyLimits(requests_per_s, burst, maps, stored_bytes, jobs)
    secret = _store(data).create(name, wanted, None if expires is None else expires * _DAY_S, limits, site=site)
    print_notice(f"The key of {name}, for {wanted}. It is not shown again:")
    typer.echo(secret)


@app.command()
def limit(
    name: Name,
    requests_per_s: RequestsPerS = None,
    burst: Burst = None,
    maps: Maps = None,
    stored_bytes: StoredBytes = None,
    jobs: Jobs = None,
    data: Data = None,
) -> None:
    """Set how much a key allows, from the next request on. Limits that are not given are lifted."""
    from rholoc.service.access.keys import KeyLimits

    key = _store(data).limit(name, KeyLimits(requests_per_s, burst, maps, stored_bytes, jobs))
    print_notice(f"The key of {name}: {_limited(key.limits) or 'no limits'}.")


@app.command("list")
def list_keys(data: Data = None, as_json: Json = False) -> None:
    """Show all keys, each below the one that handed it on."""
    store = _store(data)
    keys = store.keys()
    above = {key.name: [one.name for one in store.chain(key)[1:]] for key in keys}
    if as_json:
        shown = ("name", "scope", "created", "expires", "limits")
        print_json(
            [
                {name: value for name, value in asdict(key).items() if name in shown}
                | {"handed_on_by": next(iter(above[key.name]), None)}
                for key in keys
            ]
        )
        return
    if not keys:
        print_notice("There are no keys. Make one with rholoc key create.")
    for key in sorted(keys, key=lambda key: [*reversed(above[key.name]), key.name]):
        until = "" if key.expires is None else f", {'expired' if key.expired else 'good until'} {_day(key.expires)}"
        limits = "".join(f", {limit}" for limit in [_limited(key.limits)] if limit)
        indent = "  " * len(above[key.name])
        line = f"{indent}{key.name}: {key.scope}, made {_day(key.created)}{until}{limits}"
        output.print(line, markup=False, soft_wrap=True)


@app.command()
def revoke(name: Name, data: Data = None) -> None:
    """Revoke a key and all keys that it handed on. Within a second they are refused, and their streams end."""
    _store(data).revoke(name)
    print_notice(f"The key of {name} is revoked.")


def _store(data: Data) -> KeyStore:
    """The server's keys, in its data folder or in the shared database."""
    settings = service_settings(data_dir=data)
    if settings.shared_storage is not None:
        return opened_keys(settings)
    from rholoc.service.access.keys import KeyStore

    return KeyStore(settings.data_dir)


def _limited(limits: KeyLimits) -> str:
    """A key's limits in words; empty if it has none."""
    return ", ".join(
        words.format(value)
        for words, value in (
            ("{:g} requests a second", limits.requests_per_s),
            ("{} at once", limits.burst),
            ("{} maps", limits.maps),
            ("{} bytes", limits.stored_bytes),
            ("{} jobs", limits.jobs),
        )
        if value is not None
    )


def _day(seconds: float) -> str:
    """Date and minute, local time, of seconds since the epoch."""
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(seconds))


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
