"""The HTTP reference: the service's OpenAPI document as a page in Markdown."""

from __future__ import annotations

import json
import re
from typing import Any

_METHODS = ("get", "put", "post", "patch", "delete", "head", "options")
_LONGEST_EXAMPLE = 60  # lines
_FLAT_ARRAY = re.compile(r"\[[^\[\]{}]*\]")
_INTRODUCTION = """# HTTP reference

Every route of `rholoc serve`, as its `/openapi.json` describes them; a running server has the same at `/docs`, to try
out. [The service](server/README.md) says what does not fit here: keys and scopes, bounds, settings, errors.

"""


def page(document: dict[str, Any]) -> str:
    """An OpenAPI document (version 3.1) as Markdown: its operations by tag, then its models."""
    text, by_tag = _INTRODUCTION, _by_tag(document)
    for tag, operations in by_tag.items():
        text += f"## {tag.capitalize()}\n\n"
        for method, path, operation in operations:
            text += _operation(method, path, operation)
    text += "## Models\n\n"
    for name, schema in document["components"]["schemas"].items():
        text += _model(name, schema)
    return text


def _by_tag(document: dict[str, Any]) -> dict[str, list[tuple[str, str, dict[str, Any]]]]:
    found: dict[str, list[tuple[str, str, dict[str, Any]]]] = {}
    for path, item in document["paths"].items():
        for method in _METHODS:
            if method in item:
                tag = (item[method].get("tags") or ["other"])[0]
                found.setdefault(tag, []).append((method.upper(), path, item[method]))
    return found


def _operation(method: str, path: str, operation: dict[str, Any]) -> str:
    text = f"### `{method} {path}`\n\n**{operation['summary']}.** {operation['description']}\n\n"
    if parameters := operation.get("parameters"):
        rows = [
            [f"`{one['name']}`", one["in"], _type(one["schema"]), _said(one, one["schema"])]
            for one in sorted(parameters, key=lambda one: one["in"] != "path")
        ]
        text += _table(["parameter", "in", "type", ""], rows)
    if body := operation.get("requestBody"):
        text += _table(["body", "type"], [[f"`{kind}`", _type(one["schema"])] for kind, one in body["content"].items()])
        text += _examples(body["content"])
    answers = []
    for status, answer in operation["responses"].items():
        kinds = [f"`{kind}`: {_type(one.get('schema', {}))}" for kind, one in answer.get("content", {}).items()]
        answers.append([status, answer["description"], ", ".join(kinds)])
    text += _table(["status", "answer", "body"], answers)
    for status, answer in operation["responses"].items():
        if status.startswith("2"):
            text += _examples(answer.get("content", {}))
    return text


def _model(name: str, schema: dict[str, Any]) -> str:
    text = f"### {name}\n\n"
    if description := schema.get("description"):
        text += f"{description}\n\n"
    if "enum" in schema or "properties" not in schema:
        return text + f"{_type(schema)}\n\n"
    required = set(schema.get("required", ()))
    rows = [
        [f"`{field}`", _type(one), ("" if field in required else "optional; ") + _said(one, one)]
        for field, one in schema["properties"].items()
    ]
    return text + _table(["field", "type", ""], [[field, kind, said.rstrip("; ")] for field, kind, said in rows])


def _type(schema: dict[str, Any]) -> str:
    """What values a schema allows, in words; models are links."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    for key in ("anyOf", "oneOf", "allOf"):
        if key in schema:
            return " or ".join(dict.fromkeys(_type(one) for one in schema[key]))
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if schema.get("type") == "array":
        inner = schema.get("items") or {}
        kinds = [_type(one) for one in schema.get("prefixItems", ())] or [_type(inner)]
        return f"array of {', '.join(dict.fromkeys(kinds))}"
    if schema.get("type") == "object" and isinstance(schema.get("additionalProperties"), dict):
        return f"object of {_type(schema['additionalProperties'])}"
    if schema.get("format") == "binary":
        return "binary"
    return str(schema.get("type", "any"))


def _said(described: dict[str, Any], schema: dict[str, Any]) -> str:
    """A parameter's or a field's description, with its bounds and default."""
    said = [described.get("description", "")]
    for key, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<")):
        if key in schema:
            said.append(f"{sign} {schema[key]:g}")
    if schema.get("default") is not None:
        said.append(f"default: `{json.dumps(schema['default'])}`")
    return "; ".join(part for part in said if part)


def _examples(content: dict[str, Any]) -> str:
    """The first example of every JSON body, cut where it is long."""
    text = ""
    for kind, one in content.items():
        example = one.get("example")
        if example is None and one.get("examples"):
            example = next(iter(one["examples"].values())).get("value")
        if "json" in kind and example is not None:
            written = json.dumps(example, indent=2, ensure_ascii=False)
            lines = _FLAT_ARRAY.sub(lambda array: " ".join(array[0].split()), written).splitlines()
            shown = lines if len(lines) <= _LONGEST_EXAMPLE else [*lines[:_LONGEST_EXAMPLE], "…"]
            text += "```json\n" + "\n".join(shown) + "\n```\n\n"
    return text


def _table(heads: list[str], rows: list[list[str]]) -> str:
    def line(cells: list[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |\n"

    return line(heads) + line(["---"] * len(heads)) + "".join(line(row) for row in rows) + "\n"
