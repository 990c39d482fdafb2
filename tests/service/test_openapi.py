"""The OpenAPI document: complete, with examples, and true."""

from __future__ import annotations

import re

import pytest
from hypothesis import HealthCheck, given, settings
from pydantic import TypeAdapter

from rholoc.maps.name_rules import is_name
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.http.models import EXAMPLES, AnswerModel, RequestModel
from rholoc.service.maps.corrections import CorrectionIn

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
