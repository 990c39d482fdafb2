"""No answer contains a path of the server."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import httpx
import pytest

import rholoc
from rholoc.disk import replace_file
from rholoc.errors import InvalidInput, InvalidMap, RholocError, UnknownMap
from rholoc.library import MapLibrary
from rholoc.library.folder_documents import FolderDocuments
from rholoc.maps import load_map
from rholoc.recordings import read_recording

_PATHS = re.compile(r"/(tmp|home|root|work|var|usr|data|proc)/")
_LIBRARIES = ("maps", "recordings", "storage", "jobs", "localization", "mapping", "trajectory", "geometry", "features")


def texts_of(raised: ast.Raise) -> list[ast.FormattedValue]:
    """What is put into the texts of an error."""
    return [one for one in ast.walk(raised) if isinstance(one, ast.FormattedValue)]


def test_errors_of_libraries_name_files_and_not_paths():
    found = []
    for library in _LIBRARIES:
        for file in sorted((Path(rholoc.__file__).parent / library).rglob("*.py")):
            tree = ast.parse(file.read_text())
            for raised in (node for node in ast.walk(tree) if isinstance(node, ast.Raise)):
                found += [
                    f"{file.name}:{raised.lineno}: {ast.unparse(one.value)}"
                    for one in texts_of(raised)
                    if re.search(r"(^|\.|_)(path|folder|root)$", ast.unparse(one.value))
                ]
    assert not found


@pytest.mark.parametrize(
    ("kind", "act"),
    [
        (UnknownMap, lambda folder: load_map(folder / "room.rho")),
        (InvalidMap, lambda folder: load_map(written(folder / "room.rho", b"\xff" * 100))),
        (UnknownMap, lambda folder: MapLibrary(folder)._load("room")),
        (InvalidInput, lambda folder: replace_file(folder / "missing" / "room.rho", b"")),
        (InvalidInput, lambda folder: MapLibrary(written(folder / "maps", b"")).put_file("room", b"x")),
        (InvalidInput, lambda folder: FolderDocuments(written(folder / "keys", b"")).write("a", b"")),
        (RholocError, lambda folder: read_recording(folder / "walk")),
    ],
)
def test_errors_of_files_have_no_path(tmp_path, kind, act):
    with pytest.raises(kind) as caught:
        act(tmp_path)
    assert str(tmp_path) not in caught.value.message + caught.value.hint


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def test_no_route_answers_with_a_path(serve, picture_world):
    running = serve()
    maps, library = running.settings.maps_dir, running.app.state.rholoc.maps.sync
    (maps / "broken.rho").write_bytes(b"\xff" * 100)
    (maps / "folder.rho").mkdir()
    (maps / "unreadable.rho").symlink_to("/proc/self/mem")
    (maps / "room.rho").write_bytes(picture_world.rho())
    library.get("room")
    (maps / "gone.rho").write_bytes(picture_world.rho())
    library.get("gone")
    (maps / "gone.rho").unlink()
    parameters = {"feature": "0", "view": "0", "job": "0" * 32, "recording": "0" * 32, "name": "nobody"}
    bad_maps = ("broken", "folder", "unreadable", "gone", "nosuch")
    for path, methods in running.app.openapi()["paths"].items():
        for map_name in bad_maps if "{map_name}" in path else bad_maps[:1]:
            address = re.sub(r"\{(\w+)\}", lambda one, m=map_name: parameters.get(one[1], m), path)
            for method in methods:
                if path.endswith(("live", "events")):
                    continue
                answer = httpx.request(
                    method, running.url + address, content=b"{}", headers={"Content-Type": "application/json"}
                )
                if "json" in answer.headers.get("content-type", ""):
                    assert str(maps.parent) not in answer.text, (method, address, answer.text[:300])
                    if answer.status_code >= 400:
                        assert not _PATHS.search(answer.text), (method, address, answer.text[:300])
