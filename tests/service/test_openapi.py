"""The OpenAPI document: complete, with examples, and true."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings

from rholoc.service import Settings, create_app

METHODS = ("get", "put", "post", "patch", "delete", "head", "options")


def operations(document):
    for path, item in document["paths"].items():
        for method in METHODS:
            if method in item:
                yield f"{method.upper()} {path}", item[method]


def resolve(document, node):
    while "$ref" in node:
        target = document
        for part in node["$ref"].removeprefix("#/").split("/"):
            target = target[part]
        node = target
    return node


def has_example(document, media_type, media) -> bool:
    schema = resolve(document, media.get("schema", {}))
    binary = schema.get("format") == "binary" or media_type in ("multipart/form-data", "image/png")
    return binary or bool({"example", "examples"} & (media.keys() | schema.keys()))


def references(node):
    if isinstance(node, dict):
        yield from ([node["$ref"]] if "$ref" in node else [])
        node = list(node.values())
    if isinstance(node, list):
        for one in node:
            yield from references(one)


def test_every_operation_has_a_summary_a_description_and_examples():
    document = create_app(Settings()).openapi()
    for name, operation in operations(document):
        assert operation.get("summary"), name
        assert operation.get("description"), name
        bodies = [operation.get("requestBody", {}), *operation["responses"].values()]
        for body in bodies:
            for media_type, media in body.get("content", {}).items():
                assert has_example(document, media_type, media), (name, media_type)


def test_every_reference_leads_somewhere():
    document = create_app(Settings()).openapi()
    found = set(references(document))
    assert found
    for reference in found:
        assert resolve(document, {"$ref": reference})


@pytest.mark.slow
def test_every_route_does_what_its_schema_says(service):
    import schemathesis  # which takes a second of every start, and is used here alone
    from schemathesis.checks import CHECKS

    schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")
    schema = schemathesis.openapi.from_url(service.url + "/openapi.json")
    checks = CHECKS.get_by_names(["not_a_server_error", "status_code_conformance", "response_schema_conformance"])
    bounded = settings(
        max_examples=5, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
    )
    probed = []
    for found in schema.get_all_operations():
        operation = found.ok()

        @bounded
        @given(case=operation.as_strategy())
        def probe(case):
            case.call_and_validate(checks=checks, timeout=60)

        probe()
        probed.append(operation.label)
    assert sorted(probed) == sorted(name for name, _ in operations(create_app(Settings()).openapi()))
