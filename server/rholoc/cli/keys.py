"""``rholoc key``: who may use a server that others can reach."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli.console import output, print_json, print_notice
from rholoc.cli.options import Json, choice
from rholoc.cli.serve import Data, opened_keys, service_settings

if TYPE_CHECKING:
    from rholoc.service.keys import KeyStore

_DAY_S = 24 * 3600.0

app = typer.Typer(help="Make, list and revoke the API keys of a server.", no_args_is_help=True)

Name = Annotated[str, typer.Argument(metavar="NAME", help="Whose key it is.")]


@app.command()
def create(
    name: Name,
    scope: Annotated[
        str,
        typer.Option(metavar="read|localize|map|admin", help="What it allows; each scope includes the ones before."),
    ] = "localize",
    expires: Annotated[float | None, typer.Option(metavar="DAYS", min=0, help="How many days it is valid.")] = None,
    data: Data = None,
) -> None:
    """Make a key and print it. It is shown only once: the server only keeps its hash."""
    from rholoc.service.keys import Scope

    wanted = choice(Scope, scope, "--scope")
    secret = _store(data).create(name, wanted, None if expires is None else expires * _DAY_S)
    print_notice(f"The key of {name}, for {wanted}. It is not shown again:")
    typer.echo(secret)


@app.command("list")
def list_keys(data: Data = None, as_json: Json = False) -> None:
    """Show all keys."""
    keys = _store(data).keys()
    if as_json:
        print_json(
            [{"name": key.name, "scope": key.scope, "created": key.created, "expires": key.expires} for key in keys]
        )
        return
    if not keys:
        print_notice("There are no keys. Make one with rholoc key create.")
    for key in keys:
        until = "" if key.expires is None else f", {'expired' if key.expired else 'good until'} {_day(key.expires)}"
        output.print(f"{key.name}: {key.scope}, made {_day(key.created)}{until}", markup=False, soft_wrap=True)


@app.command()
def revoke(name: Name, data: Data = None) -> None:
    """Revoke a key. It is refused from the next request on."""
    _store(data).revoke(name)
    print_notice(f"The key of {name} is revoked.")


def _store(data: Data) -> KeyStore:
    settings = service_settings(data_dir=data)
    if settings.shared_storage is not None:
        return opened_keys(settings)
    from rholoc.service.keys import KeyStore

    return KeyStore(settings.data_dir)


def _day(seconds: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(seconds))
