"""``rholoc serve`` and ``rholoc worker``: the processes of the service."""

from __future__ import annotations

import gc
import logging
import os
import socket
import sys
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from rholoc.cli.console import notices, print_notice, print_qr_code
from rholoc.errors import Conflict, InvalidInput, RholocError, StorageFull, StorageUnavailable

if TYPE_CHECKING:
    from rholoc.service import Settings
    from rholoc.service.access.keys import KeyStore

_BACKLOG = 2048
_SHUTDOWN_S = 5  # for requests in progress; clients that watch a job would otherwise stay as long as it takes
_SWITCH_INTERVAL_S = 0.0005  # with Python's default of 5 ms, a frame's many steps take twice as long beside other work
_EVERYWHERE = "0.0.0.0"
_PHONE_KEY_S = 2 * 3600  # lifetime of the key in the QR code

Maps = Annotated[
    Path | None, typer.Option("--maps", metavar="DIR", help="The folder of maps; default: RHOLOC_MAPS_DIR or maps.")
]
Data = Annotated[
    Path | None,
    typer.Option("--data", metavar="DIR", help="The folder of jobs; default: RHOLOC_DATA_DIR or .rholoc."),
]


def serve(
    host: Annotated[
        str | None, typer.Option(help="The address to listen on; default: RHOLOC_HOST or 127.0.0.1. 0.0.0.0: all.")
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="The port; default: RHOLOC_PORT or 8080. 0: a free one.")
    ] = None,
    maps: Maps = None,
    data: Data = None,
    no_worker: Annotated[bool, typer.Option("--no-worker", help="Leave mapping jobs to rholoc worker.")] = False,
    tls: Annotated[
        bool,
        typer.Option(
            "--tls", help="HTTPS, which phones' cameras need; listens on all addresses unless --host says otherwise."
        ),
    ] = False,
) -> None:
    """Serve maps over HTTP, and work on mapping jobs too."""
    settings = service_settings(host=host, port=port, maps_dir=maps, data_dir=data, worker=False if no_worker else None)
    if tls and "host" not in settings.model_fields_set:
        settings = settings.model_copy(update={"host": _EVERYWHERE})
    import uvicorn

    from rholoc.logs import configure_process_logs
    from rholoc.service import create_app
    from rholoc.service.http.connections import protocol_of, websocket_options
    from rholoc.service.settings import keys_needed
    from rholoc.service.threads.compute import compute_threads
    from rholoc.service.threads.storage import storage_threads

    source = "the shared storage"
    if settings.shared_storage is None:
        source = f"{settings.maps_dir}{'' if settings.maps_dir.exists() else ', a new folder,'}"
        settings.maps_dir.mkdir(parents=True, exist_ok=True)  # reported here, in one line, if they cannot be used
    keys = _keys(settings)
    if not keys_needed(settings.keys, settings.host):
        keys = None
    has_none = keys is not None and not keys.keys()
    with listening_socket(settings.host, settings.port) as listener:
        config = uvicorn.Config(
            create_app(settings),
            log_level="warning",
            log_config=None,
            http=protocol_of(settings.max_connections, settings.slow_client_timeout_s),
            **websocket_options(settings.max_request_bytes),
            backlog=_BACKLOG,
            timeout_graceful_shutdown=_SHUTDOWN_S,
        )
        port = listener.getsockname()[1]
        where = f"http://{settings.host}:{port}"
        if tls:
            config.ssl_certfile, where = _https(settings, port, keys)

        class Announced(uvicorn.Server):
            """Prints its address once it serves; from then on an interrupt ends it cleanly."""

            async def startup(self, sockets: list[socket.socket] | None = None) -> None:
                await super().startup(sockets)
                if self.started:
                    print_notice(f"Serving the maps of {source} at {where} (the API: /docs).")

            def handle_exit(self, sig: int, frame: FrameType | None) -> None:
                super().handle_exit(sig, frame)
                if self.force_exit:  # what a second interrupt breaks off is no error to report
                    logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)

        server = Announced(config)
        configure_process_logs()
        sys.setswitchinterval(_SWITCH_INTERVAL_S)
        # Objects of modules are permanent. Scanning them takes 0.1 s, for which all threads wait.
        gc.collect()
        gc.freeze()
        if has_none:
            print_notice("It asks for API keys, and there is none yet: rholoc key create NAME --scope admin")
        try:
            server.run(sockets=[listener])
        except KeyboardInterrupt:
            _end_at_once(130)
    if not server.started:
        raise InvalidInput("The server did not start.", "The lines above say why.")
    if compute_threads() or storage_threads():  # Python would wait for them
        _end_at_once(0)


def _end_at_once(status: int) -> NoReturn:
    """End this process with ``status`` at once: Python's clean-up waits for threads, or crashes beside native ones."""
    with suppress(OSError):  # nobody reads them any more
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


def phone_link(where: str, keys: KeyStore | None) -> str:
    """Link that opens the recorder, with a new key of scope ``map`` for two hours if the server needs keys and can
    store it.

    Args:
        where: the server's address.
        keys: None if the server needs no keys.
    """
    from rholoc.service.access.keys import KeyLimits, Scope

    if keys is None:
        return f"{where}/record"
    try:
        _, secret = keys.hand_on(Scope.MAP, _PHONE_KEY_S, KeyLimits(), None)
    except RholocError:  # a server starts on a full disk, too; the recorder asks for a key
        return f"{where}/record"
    return f"{where}/record#/key/{secret}/"


def _https(settings: Settings, port: int, keys: KeyStore | None) -> tuple[Path, str]:
    """The server's certificate, made if necessary, and its address; prints the recorder's, as a QR code too."""
    from rholoc.service.operate.certificates import addresses, server_certificate

    everywhere = settings.host in (_EVERYWHERE, "::")
    hosts = (*addresses(), "127.0.0.1") if everywhere else (settings.host,)
    name = socket.gethostname()
    names = dict.fromkeys((*hosts, "127.0.0.1", "::1", "localhost", name, f"{name.removesuffix('.local')}.local"))
    certificate = server_certificate(settings.data_dir, tuple(names))
    where = f"https://{f'[{hosts[0]}]' if ':' in hosts[0] else hosts[0]}:{port}"
    print_notice(f"Record with a phone at {where}/record")
    if notices.is_terminal:
        link = phone_link(where, keys)
        print_qr_code(link)
        if link != f"{where}/record":
            print_notice("The QR code has a key in it that is valid for two hours.")
    print_notice(f"Phones warn of its certificate, and programs refuse it, until they trust {certificate.authority}")
    return certificate.path, where


def worker(maps: Maps = None, data: Data = None) -> None:
    """Work on mapping jobs, apart from the server. Any number of workers share the queue."""
    from rholoc.logs import configure_process_logs
    from rholoc.processes.interrupts import interruptible
    from rholoc.worker.worker import run_worker

    configure_process_logs()
    settings = service_settings(maps_dir=maps, data_dir=data)
    target = settings.maps_dir if settings.shared_storage is None else "the shared storage"
    with interruptible():  # until the worker listens itself: SIGINT may have been ignored by whoever started this
        print_notice(f"Working on the jobs of {settings.data_dir}; maps go to {target}.")
        run_worker(settings.worker_setup)


def _keys(settings: Settings) -> KeyStore | None:
    """The API keys; None, after a notice, if the database does not answer: the server starts without it.

    Raises:
        Conflict: the file is not an SQLite database.
        InvalidInput: PostgreSQL refuses the connection.
    """
    from sqlalchemy.exc import SQLAlchemyError

    from rholoc.service.errors import as_rholoc_error

    try:
        return opened_keys(settings)
    except (RholocError, OSError, SQLAlchemyError) as error:
        known = as_rholoc_error(error)
        if not isinstance(known, StorageFull | StorageUnavailable):
            raise
        print_notice(f"{known.message} The server starts all the same, and opens its database when it can.")
        return None


def opened_keys(settings: Settings) -> KeyStore:
    """The API keys, after a successful connection to the database.

    Raises:
        InvalidInput, Conflict, StorageFull, StorageUnavailable: the database cannot be opened.
    """
    from rholoc.library.stores import KEYS
    from rholoc.service.access.keys import KeyStore

    stores = settings.stores()
    stores.open()
    stores.engine.dispose()
    return KeyStore(stores.documents(KEYS))


def service_settings(**options: object) -> Settings:
    """The settings: options other than None, else the environment's, else the defaults. Raises InvalidInput."""
    from pydantic import ValidationError

    from rholoc.service import Settings

    try:
        return Settings(**{name: value for name, value in options.items() if value is not None})  # type: ignore[arg-type]
    except ValidationError as error:
        first = error.errors()[0]
        name = "_".join(str(part) for part in first["loc"])
        raise InvalidInput(f"The setting {name} is wrong: {first['msg']}.", f"See RHOLOC_{name.upper()}.") from error


def listening_socket(host: str, port: int) -> socket.socket:
    """The socket that the service listens on.

    Raises:
        InvalidInput: ``host`` is not an address.
        Conflict: the port is taken, or may not be used.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family, backlog=_BACKLOG)
    except socket.gaierror as error:
        raise InvalidInput(f"{host} is not an address to listen on.", "Give an IP address of this machine.") from error
    except OSError as error:
        raise Conflict(
            f"Cannot listen on {host}:{port}: {(error.strerror or str(error)).lower()}.",
            "Choose another with --port, or stop what is listening there.",
        ) from error
    # Every connection inherits this. Without it, an answer's last packet waits 40 ms for the client's acknowledgement.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listener
