"""Pictures and figures of a map for people. As a program, a process that does nothing else.

It reads requests from its standard input, a line of JSON each, ``{"source", "name", "kind", "target"}``, and answers
with a line, ``{}`` once the rendering is in the file ``target``, else ``{"code", "error", "hint"}``. It ends with its
input.
"""

import json
import sys
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TextIO

from rholoc.disk import replace_file
from rholoc.errors import RholocError
from rholoc.maps.coverage import coverage_of
from rholoc.maps.formats.rho_file import load_map
from rholoc.maps.map import Map
from rholoc.reports import report_to_json


class Rendering(StrEnum):
    """A picture or figure of a map; the value ends its file's name."""

    PREVIEW = "preview.png"
    REPORT = "report.png"
    COVERAGE = "coverage.json"


def render(map_: Map, name: str, kind: Rendering) -> bytes:
    """The rendering of a map called ``name``: a PNG, or JSON of coverage."""
    return _RENDERERS[kind](map_, name)


def serve(requests: TextIO, answers: TextIO) -> None:
    """Answer each line of ``requests`` (JSON) with a line in ``answers``, until the input ends."""
    for line in requests:
        answers.write(json.dumps(_answer(json.loads(line))) + "\n")
        answers.flush()


def _answer(request: dict[str, str]) -> dict[str, str]:
    """Draw a rendering into the request's file ``target``. Returns {}, or an error as "code", "error" and "hint"."""
    name = request["name"]
    try:
        map_ = load_map(Path(request["source"]), f"{name}.rho")
        replace_file(Path(request["target"]), render(map_, name, Rendering(request["kind"])), called="a picture")
    except RholocError as error:
        return {"code": error.code, "error": error.message, "hint": error.hint}
    return {}


def _preview(map_: Map, name: str) -> bytes:
    """PNG of the map from above."""
    from rholoc.pictures.map_preview import preview_png  # matplotlib is loaded only where something is drawn

    return preview_png(map_, title=name)


def _report(map_: Map, name: str) -> bytes:
    """PNG of the map's report."""
    from rholoc.pictures.map_report import report_png

    return report_png(map_, name)


def _coverage(map_: Map, _name: str) -> bytes:
    """JSON of the map's coverage, as in its report."""
    return json.dumps(report_to_json(coverage_of(map_).report()), separators=(",", ":"), allow_nan=False).encode()


_RENDERERS: dict[Rendering, Callable[[Map, str], bytes]] = {
    Rendering.PREVIEW: _preview,
    Rendering.REPORT: _report,
    Rendering.COVERAGE: _coverage,
}


if __name__ == "__main__":
    serve(sys.stdin, sys.stdout)
