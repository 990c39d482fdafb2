"""The web page: the console, the recorder, the API's description. Their files are under ``/web``, and those of the
JavaScript client, which they import, under ``/js``."""

import mimetypes
import os
from collections.abc import Awaitable, Callable
from pathlib import Path

from fastapi import FastAPI, Request, Response
from starlette.staticfiles import StaticFiles

from rholoc.service.access.scopes import OPEN

FOLDERS = {"/web": "page", "/js": "js"}
PAGES = {"/": "index.html", "/record": "record/index.html", "/here/{site}": "here/index.html", "/docs": "docs.html"}
_SWAGGER_UI = ("fastapi_offline", "static")  # the package that has its files
_TYPES = {".js": "text/javascript", ".webmanifest": "application/manifest+json", ".svg": "image/svg+xml"}
_SERVICE_WORKER = "service-worker.js"


def web_folder() -> Path:
    """The folder of the page and the JavaScript client: in the installed package, or ``client`` of a checkout."""
    installed = Path(__file__).parents[1] / "web_files"
    return installed if installed.is_dir() else Path(__file__).parents[4] / "client"


class _PageFiles(StaticFiles):
    """Files that a browser caches and revalidates before each use: a new version is seen at once, at a 304's cost."""

    def file_response(self, full_path: str | os.PathLike[str], *args: object, **options: object) -> Response:
        """The file as a response that browsers cache and revalidate."""
        response = super().file_response(full_path, *args, **options)  # type: ignore[arg-type]
        response.headers["Cache-Control"] = "no-cache"
        if Path(full_path).name == _SERVICE_WORKER:
            response.headers["Service-Worker-Allowed"] = "/"
        return response


def install(app: FastAPI) -> None:
    """Serve the page's files with the app, to everyone: pages, /web, /js and Swagger UI; browsers revalidate them."""
    for suffix, kind in _TYPES.items():
        mimetypes.add_type(kind, suffix)  # operating systems have different types
    folders = {prefix: _PageFiles(directory=web_folder() / name) for prefix, name in FOLDERS.items()}
    served = {
        "/web/swagger/{file:path}": _file(_PageFiles(packages=[_SWAGGER_UI])),
        **{f"{prefix}/{{file:path}}": _file(files) for prefix, files in folders.items()},
        **{path: _page(folders["/web"], name) for path, name in PAGES.items()},
    }
    for path, answer in served.items():
        app.add_api_route(path, answer, methods=["GET", "HEAD"], include_in_schema=False, dependencies=[OPEN])


def _file(files: StaticFiles) -> Callable[[Request], Awaitable[Response]]:
    """Handler that answers with the file named in the request's path."""

    async def file(request: Request) -> Response:
        return await files.get_response(os.path.normpath(request.path_params["file"]), request.scope)

    return file


def _page(files: StaticFiles, name: str) -> Callable[[Request], Awaitable[Response]]:
    """Handler that answers with the file ``name``, whatever the request's path."""

    async def page(request: Request) -> Response:
        return await files.get_response(name, request.scope)

    return page
