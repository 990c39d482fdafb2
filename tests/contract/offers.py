"""What rholoc offers to programs and people: routes, commands, settings and Python names, as one kind of list."""

import dataclasses
import enum
import importlib
import inspect
import re
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer.main

from rholoc.cli import app
from rholoc.service import Settings, create_app

Offer = dict[str, Any]
"""``takes``: each parameter, and whether it is required; ``in_order``: those that are given by their position;
``gives``: members of the answer."""


def present_offers() -> dict[str, dict[str, Offer]]:
    """All offers of this version by kind and name."""
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(maps_dir=Path(folder) / "maps", data_dir=Path(folder) / "data")
        openapi = create_app(settings).openapi()
    return {
        "routes": dict(sorted(_routes(openapi))),
        "commands": dict(sorted(_commands(typer.main.get_command(app), ""))),
        "settings": {f"RHOLOC_{name.upper()}": _offer() for name in sorted(Settings.model_fields)},
        "python": dict(sorted([*_names("rholoc_client", with_methods=True), *_names("rholoc")])),
    }


def broken_promises(kept: Mapping[str, Offer], present: Mapping[str, Offer]) -> list[str]:
    """What was offered and is not any more, one line each. Additions break nothing unless they are required."""
    broken = []
    for name, before in kept.items():
        if name not in present:
            broken.append(f"{name} is gone")
            continue
        now = present[name]
        broken += [f"{name} no longer takes {one}" for one in before["takes"] if one not in now["takes"]]
        required = [one for one, is_required in now["takes"].items() if is_required]
        broken += [f"{name} now requires {one}" for one in required if not before["takes"].get(one, False)]
        broken += [f"{name} no longer gives {one}" for one in before["gives"] if one not in now["gives"]]
        if now["in_order"][: len(before["in_order"])] != before["in_order"]:
            broken.append(f"{name} takes {now['in_order']} in this order, no longer {before['in_order']}")
    return broken


def _offer(takes: Mapping[str, bool] | None = None, in_order: Any = (), gives: Any = ()) -> Offer:
    return {"takes": dict(takes or {}), "in_order": list(in_order), "gives": sorted(set(gives))}


def _routes(openapi: Any) -> Iterator[tuple[str, Offer]]:
    for path, item in openapi["paths"].items():
        for method, operation in item.items():
            takes = {}
            for given in operation.get("parameters", ()):
                if given["in"] != "path":
                    takes[f"{given['in']} {given['name']}"] = given.get("required", False)
            for media, content in operation.get("requestBody", {}).get("content", {}).items():
                takes[media] = False
                for member, is_required in _members(openapi, content.get("schema", {})):
                    takes[f"{media} {member}"] = is_required
            gives = [
                f"{status} {media} {member}".strip()
                for status, answer in operation["responses"].items()
                if status.startswith("2")
                for media, content in (answer.get("content") or {"": {}}).items()
                for member, _ in [("", True), *_members(openapi, content.get("schema", {}))]
            ]
            yield f"{method.upper()} {re.sub('{[^}]*}', '{}', path)}", _offer(takes, gives=gives)


def _members(openapi: Any, schema: Any, above: tuple[str, ...] = (), prefix: str = "") -> Iterator[tuple[str, bool]]:
    """Path of each member of a JSON value such as ``maps[].name``, and whether it is required where its parent is."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        if name not in above:
            yield from _members(openapi, openapi["components"]["schemas"][name], (*above, name), prefix)
        return
    for kind in ("anyOf", "oneOf", "allOf"):
        choices = [one for one in schema.get(kind, ()) if one.get("type") != "null"]
        for one in choices:
            for member, is_required in _members(openapi, one, above, prefix):
                yield member, is_required and (kind == "allOf" or len(choices) == 1)
    if isinstance(schema.get("items"), dict):
        yield from _members(openapi, schema["items"], above, f"{prefix}[]")
    for name, member in schema.get("properties", {}).items():
        path = f"{prefix}.{name}".lstrip(".")
        yield path, name in schema.get("required", ())
        yield from _members(openapi, member, above, path)


def _commands(command: Any, path: str) -> Iterator[tuple[str, Offer]]:
    if hasattr(command, "commands"):
        for name, one in command.commands.items():
            yield from _commands(one, f"{path} {name}".strip())
        return
    options = [one for one in command.params if one.param_type_name == "option"]
    arguments = [one for one in command.params if one.param_type_name == "argument"]
    takes = {text: one.required for one in options for text in (*one.opts, *one.secondary_opts)}
    takes |= {one.name: one.required for one in arguments}
    yield path, _offer(takes, [one.name for one in arguments])


def _names(module: str, with_methods: bool = False) -> Iterator[tuple[str, Offer]]:
    for name in importlib.import_module(module).__all__:
        thing = getattr(importlib.import_module(module), name)
        yield f"{module}.{name}", _called(thing)
        if with_methods and inspect.isclass(thing) and not issubclass(thing, enum.Enum):
            for method, function in inspect.getmembers(
                thing, lambda one: inspect.isfunction(one) or inspect.ismethod(one)
            ):
                if not method.startswith("_") and not inspect.ismethoddescriptor(function):
                    yield f"{module}.{name}.{method}", _called(function)


def _called(thing: Any) -> Offer:
    if inspect.isclass(thing) and issubclass(thing, enum.Enum):
        return _offer(gives=[one.value for one in thing])
    gives: list[str] = []
    if inspect.isclass(thing):
        gives = [one.name for one in dataclasses.fields(thing)] if dataclasses.is_dataclass(thing) else []
        gives += [name for name, _ in inspect.getmembers(thing, lambda one: isinstance(one, property))]
        gives += [base.__name__ for base in thing.__mro__ if base.__module__.startswith("rholoc")]
    if inspect.isclass(thing) and issubclass(thing, Exception):  # callers catch them, and do not make them
        return _offer(gives=gives)
    parameters = [
        one
        for one in inspect.signature(thing).parameters.values()
        if one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD) and one.name != "self"
    ]
    return _offer(
        {one.name: one.default is one.empty for one in parameters},
        [one.name for one in parameters if one.kind is not one.KEYWORD_ONLY],
        [one for one in gives if not one.startswith("_")],
    )
