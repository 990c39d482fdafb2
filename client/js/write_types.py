"""Write the TypeScript declarations of @rholoc/client: ``python client/js/write_types.py``, part of ``make format``.

``types/api.d.ts`` says what the service takes and answers, from its OpenAPI document; the other files are what tsc
declares of the sources.
"""

import json
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
TYPES = FOLDER / "types"
ROOTS = ("LocalizationOut", "LocalizeOptions", "MapSummary", "MapDetail", "JobOut")
_MIN_SHARED = 5  # members of a type that another extends; fewer may be the same by chance
_NOTE = "// Written by client/js/write_types.py: run `make format`.\n"
_PLAIN = {"string": "string", "number": "number", "integer": "number", "boolean": "boolean", "null": "null"}
_REFERENCE = re.compile(r"#/components/schemas/(\w+)")
_DECLARED = re.compile(r"^ *\* @(param \{.*\} [\w.\[\]]+|returns \{.*\})\n", re.MULTILINE)  # tags that say a type alone
_ALONE = re.compile(r"/\*\*\n *\* (.+)\n *\*/")  # comments whose one line is left
_WORD = re.compile(r"^[A-Za-z_$][\w$]*$")


def api_types(schemas: dict[str, Any]) -> str:
    """Declarations of ``ROOTS`` and of all schemas that these refer to, from ``components.schemas``."""
    names, waiting = set[str](), [*ROOTS]
    while waiting:
        name = waiting.pop()
        if name not in names:
            names.add(name)
            waiting += _REFERENCE.findall(json.dumps(schemas[name]))
    members = {name: _members(schemas[name]) for name in sorted(names)}
    return _NOTE + "".join(_declaration(name, schemas[name], members) for name in members)


def written_types(schemas: dict[str, Any]) -> dict[str, str]:
    """All files of ``types`` by name."""
    api, tsc = api_types(schemas), FOLDER.parent / "node_modules" / ".bin" / "tsc"
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name)
        for source in FOLDER.glob("*.js"):
            (copy / source.name).write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
        (copy / "types").mkdir()
        (copy / "types" / "api.d.ts").write_text(api, encoding="utf-8")
        emit = ["--allowJs", "--declaration", "--emitDeclarationOnly", "--outDir", copy / "out", "--skipLibCheck"]
        target = ["--target", "es2023", "--module", "esnext", "--moduleResolution", "bundler"]
        subprocess.run([tsc, *emit, *target, copy / "index.js"], check=True, cwd=copy)
        declared = {path.name: path.read_text(encoding="utf-8") for path in sorted((copy / "out").glob("*.d.ts"))}
    own = {name: _without_types(text).replace('"./types/api.d.ts"', '"./api.d.ts"') for name, text in declared.items()}
    return {"api.d.ts": api, **{name: _NOTE + text for name, text in own.items()}}


def _without_types(text: str) -> str:
    """Declarations without the comments that repeat them."""
    return _ALONE.sub(r"/** \1 */", _DECLARED.sub("", text))


def _declaration(name: str, schema: dict[str, Any], members: dict[str, list[str]]) -> str:
    """Declaration of one type, which extends the largest type in ``members`` of which it has all members."""
    comment, own = _comment(schema, ""), members[name]
    if not own:
        return f"\n{comment}export type {name} = {_type(schema)};\n"
    within = [one for one in members if set(members[one]) < set(own) and len(members[one]) >= _MIN_SHARED]
    base = max(within, key=lambda one: len(members[one]), default=None)
    extends = f" extends {base}" if base else ""
    further = "".join(one for one in own if base is None or one not in members[base])
    return f"\n{comment}export interface {name}{extends} {{\n{further}}}\n"


def _members(schema: dict[str, Any]) -> list[str]:
    required = set(schema.get("required", ()))
    return [
        f"{_comment(one, '  ')}  {_key(key)}{'' if key in required else '?'}: {_type(one)};\n"
        for key, one in schema.get("properties", {}).items()
    ]


def _type(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    if "enum" in schema or "const" in schema:
        return " | ".join(json.dumps(one) for one in schema.get("enum", [schema.get("const")]))
    for several in ("anyOf", "oneOf"):
        if several in schema:
            return " | ".join(dict.fromkeys(_type(one) for one in schema[several]))
    match schema.get("type"):
        case "array" if "prefixItems" in schema:
            return f"[{', '.join(_type(one) for one in schema['prefixItems'])}]"
        case "array":
            inner = _type(schema.get("items", {}))
            return f"({inner})[]" if " " in inner else f"{inner}[]"
        case "object" if isinstance(schema.get("additionalProperties"), dict):
            return f"Record<string, {_type(schema['additionalProperties'])}>"
        case "object":
            return "Record<string, unknown>"
        case kind:
            return _PLAIN.get(str(kind), "unknown")


def _comment(schema: dict[str, Any], indent: str) -> str:
    text = " ".join(str(schema.get("description", "")).partition("\n\n")[0].replace("*/", "* /").split())
    return f"{indent}/** {text} */\n" if text else ""


def _key(name: str) -> str:
    return name if _WORD.match(name) else json.dumps(name)


if __name__ == "__main__":
    from rholoc.service.app import create_app
    from rholoc.service.settings import Settings

    TYPES.mkdir(exist_ok=True)
    for name, text in written_types(create_app(Settings()).openapi()["components"]["schemas"]).items():
        (TYPES / name).write_text(text, encoding="utf-8")
