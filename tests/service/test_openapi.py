"""The OpenAPI document: complete, with examples, and true."""

import ast
import re
from pathlib import Path

import httpx
import pytest
from fastapi.routing import APIWebSocketRoute, iter_route_contexts
from hypothesis import HealthCheck, given, settings
from pydantic import TypeAdapter

import rholoc
from rholoc.disk import replace_file
from rholoc.errors import InvalidInput, InvalidMap, RholocError, UnknownMap
from rholoc.library.folder_documents import FolderDocuments
from rholoc.library.maps import MapLibrary
from rholoc.maps import load_map
from rholoc.maps.name_rules import is_name
from rholoc.recordings import read_recording
from rholoc.service import Settings, create_app
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.errors import error_classes, status_of
from rholoc.service.http.models import EXAMPLES, AnswerModel, RequestModel
from rholoc.service.maps.corrections import CorrectionIn
from rholoc.service.routes.frames.track_messages import Begin, FrameMessage, TrackedOut

METHODS = ("get", "put", "post", "patch", "delete", "head", "options")


def operations(openapi):
    for path, item in openapi["paths"].items():
        for method in METHODS:
            if method in item:
                yield f"{method.upper()} {path}", item[method]


def resolve(openapi, node):
    while "$ref" in node:
        target = openapi
        for part in node["$ref"].removeprefix("#/").split("/"):
            target = target[part]
        node = target
    return node


def has_example(openapi, media_type, media) -> bool:
    schema = resolve(openapi, media.get("schema", {}))
    binary = schema.get("format") == "binary" or media_type in ("multipart/form-data", "image/png")
    return binary or bool({"example", "examples"} & (media.keys() | schema.keys()))


def references(node):
    if isinstance(node, dict):
        yield from ([node["$ref"]] if "$ref" in node else [])
        node = list(node.values())
    if isinstance(node, list):
        for one in node:
            yield from references(one)


def test_every_example_is_one():
    models = {model.__name__: model for base in (RequestModel, AnswerModel) for model in subclasses(base)}
    for name, example in EXAMPLES.items():
        if name == "CorrectionIn":  # one of each kind
            for correction in example.values():
                TypeAdapter(CorrectionIn).validate_python(correction)
        else:
            models[name].model_validate(example)


def subclasses(kind):
    for one in kind.__subclasses__():
        yield one
        yield from subclasses(one)


def test_every_operation_has_a_summary_a_description_and_examples(openapi):
    for name, operation in operations(openapi):
        assert operation.get("summary"), name
        assert operation.get("description"), name
        bodies = [operation.get("requestBody", {}), *operation["responses"].values()]
        for body in bodies:
            for media_type, media in body.get("content", {}).items():
                assert has_example(openapi, media_type, media), (name, media_type)


def test_every_reference_leads_somewhere(openapi):
    found = set(references(openapi))
    assert found
    for reference in found:
        assert resolve(openapi, {"$ref": reference})


def test_a_path_says_which_names_it_takes_as_the_service_does(openapi):
    patterns = {}
    for _, operation in operations(openapi):
        for parameter in operation.get("parameters", ()):
            if parameter["in"] == "path" and "pattern" in parameter["schema"]:
                patterns.setdefault(parameter["name"], set()).add(parameter["schema"]["pattern"])
    assert set(patterns) == {"map_name", "site", "camera", "name", "recording", "job"}
    for (pattern,) in (patterns["map_name"], patterns["site"], patterns["camera"], patterns["name"]):
        for name in ("a", "_a", "9.b", "a" * 64, "A-b_c.d", "", ".a", "-a", "a" * 65, "a b", "é", "a/b"):
            assert (re.fullmatch(pattern, name) is not None) is is_name(name)


# The values of these are more than a schema says: numbers of features, moments, what exists.
SAY_MORE = {"GET /v1/maps/{map_name}/download", "GET /v1/audit", "GET /v1/jobs"}


def probe(operation, key, checks):
    """Send a few requests that the schema allows and forbids, and judge the answers."""

    @settings(max_examples=4, database=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(case=operation.as_strategy())
    def send(case):
        case.call_and_validate(headers=key, checks=checks, timeout=60)

    send()


@pytest.mark.slow
def test_every_route_does_what_its_schema_says(locked, openapi):
    import schemathesis  # which takes a second of every start, and is used here alone
    from schemathesis.checks import CHECKS

    schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")
    key = {"Authorization": f"Bearer {KeyStore(locked.settings.data_dir).create('probe', Scope.ADMIN)}"}
    schema = schemathesis.openapi.from_url(locked.url + "/openapi.json", headers=key)
    probed = []
    for found in schema.get_all_operations():
        operation = found.ok()
        says_more = "requestBody" in operation.definition.raw or operation.label in SAY_MORE
        names = [name for name in CHECKS.get_all_names() if name != "positive_data_acceptance" or not says_more]
        probe(operation, key, CHECKS.get_by_names(names))
        probed.append(operation.label)
    assert sorted(probed) == sorted(name for name, _ in operations(openapi))


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


@pytest.mark.slow
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
