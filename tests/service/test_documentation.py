"""What is not documented fails here: every route, setting and error code is in docs/service."""

from __future__ import annotations

import re
from pathlib import Path

from fastapi.routing import APIWebSocketRoute, iter_route_contexts

from rholoc.service import Settings, create_app
from rholoc.service.errors import error_classes, status_of
from rholoc.service.routes.frames.track_messages import Begin, FrameMessage, TrackedOut

PAGES = "".join(
    page.read_text(encoding="utf-8") for page in sorted((Path(__file__).parents[2] / "docs" / "service").glob("*.md"))
)


def rows(heading: str) -> dict[str, list[str]]:
    """The table under a heading: its first column → the others."""
    section = PAGES.split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]
    lines = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| `")]
    return {cells[0].strip().strip("`"): [cell.strip().strip("`") for cell in cells[1:]] for cells in lines}


def test_every_route_is_documented_and_no_other(openapi):
    documented = {name for name in rows("Routes") if " /" in name}
    assert documented == {f"{method.upper()} {path}" for path, item in openapi["paths"].items() for method in item}


def test_every_stream_is_documented_and_no_other():
    contexts = iter_route_contexts(create_app(Settings()).routes)
    streams = {context.path for context in contexts if isinstance(context.original_route, APIWebSocketRoute)}
    assert streams
    assert streams == set(re.findall(r"^\| `(/v1/\S+)` \|", PAGES, re.MULTILINE))


def test_every_message_of_a_stream_is_documented():
    section = PAGES.split("## A stream of frames\n", 1)[1].split("\n## ", 1)[0]
    for model in (Begin, FrameMessage, TrackedOut):
        for name in model.model_fields:
            assert f"`{name}`" in section or f'"{name}"' in section, name


def test_every_error_code_is_documented_with_its_status_and_no_other():
    documented = {code: int(cells[0]) for code, cells in rows("Errors").items()}
    assert documented == {kind.code: status_of(kind) for kind in error_classes()}


def test_every_setting_is_documented_with_its_default_and_no_other():
    documented = rows("Settings")
    assert set(documented) == {f"RHOLOC_{name.upper()}" for name in Settings.model_fields}
    for name, field in Settings.model_fields.items():
        if field.default_factory is None:
            assert documented[f"RHOLOC_{name.upper()}"][0] == str(field.default).replace("True", "true").removesuffix(
                ".0"
            )


def test_every_setting_comes_from_the_environment(monkeypatch):
    monkeypatch.setenv("RHOLOC_PORT", "81")
    monkeypatch.setenv("RHOLOC_WORKER", "false")
    assert (Settings().port, Settings().worker) == (81, False)


def test_every_parameter_of_a_query_is_documented(openapi):
    operation = openapi["paths"]["/v1/maps/{map_name}/localize"]["post"]
    names = {one["name"] for one in operation["parameters"]}
    assert {"fx", "distortion", "dof", "prior_position", "prior_radius_deg", "deadline_ms"} < names
    assert [name for name in names if not re.search(rf"`{name}\b", PAGES)] == ["map_name"]
