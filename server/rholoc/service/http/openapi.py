"""OpenAPI for bodies that routes parse themselves, and for the errors of each route."""

from collections.abc import Mapping, Sequence
from typing import Any

from fastapi import FastAPI, Response
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from pydantic.json_schema import models_json_schema

from rholoc.errors import RholocError, TooLarge
from rholoc.service.access.scopes import OPEN
from rholoc.service.errors import (
    CrossSite,
    Forbidden,
    InvalidRequest,
    QuotaExceeded,
    TooManyRequests,
    Unauthorized,
    status_of,
)
from rholoc.service.http.models import AnswerModel


class ErrorAnswer(AnswerModel):
    """The one shape of all errors."""

    code: str = Field(description="Stable: programs tell errors apart by it.")
    message: str = Field(description="One line: what is wrong.")
    hint: str = Field(description="One line: what to do.")
    request_id: str = Field(description="The same as in the header X-Request-ID and in the service's log.")


_REF = "#/components/schemas/{model}"
_PATTERNS = {
    **dict.fromkeys(("map_name", "site", "camera", "name"), r"^[A-Za-z0-9_][A-Za-z0-9._-]{0,63}$"),
    **dict.fromkeys(("recording", "job"), "^[0-9a-f]{32}$"),
}
BINARY = {"type": "string", "format": "binary"}


def reference(model: type[BaseModel]) -> dict[str, str]:
    """A JSON reference to the schema of a model."""
    return {"$ref": _REF.format(model=model.__name__)}


def request_body(content: dict[str, Any]) -> dict[str, Any]:
    """``openapi_extra`` for a body that the route reads by hand: media type → schema and example."""
    return {"requestBody": {"required": True, "content": content}}


def declared(
    access: object, summary: str, *errors: type[RholocError], also: Mapping[int, dict[str, Any]] | None = None
) -> dict[str, Any]:
    """Keyword arguments that declare a route.

    Args:
        access: required access, of :mod:`rholoc.service.access.scopes`.
        summary: title in the OpenAPI document.
        errors: of this route, in addition to those common to all routes.
        also: further answers by status; one of 200 without a model is the route's only answer.
    """
    also = also or {}
    options: dict[str, Any] = {"dependencies": [access], "summary": summary, "responses": {**failures(*errors), **also}}
    if 200 in also and "model" not in also[200]:
        options["response_class"] = Response
    return options


def content(description: str, *media_types: str) -> dict[int, dict[str, Any]]:
    """``responses`` of a route that sends bytes of one of these media types, for :func:`declared`."""
    return {200: {"description": description, "content": {kind: {"schema": BINARY} for kind in media_types}}}


def event_stream(event: str) -> dict[int, dict[str, Any]]:
    """``responses`` of a route that sends server-sent events, with an example, for :func:`declared`."""
    schema = {"schema": {"type": "string"}, "example": event}
    return {200: {"description": "Server-sent events.", "content": {"text/event-stream": schema}}}


def failures(*kinds: type[RholocError]) -> dict[int | str, dict[str, Any]]:
    """``responses`` for the errors that a route answers with, by status, an example each, of the class's first line."""
    answers: dict[int | str, dict[str, Any]] = {}
    for kind in kinds:
        summary = (kind.__doc__ or "").strip().splitlines()[0]
        example = {"code": kind.code, "message": summary, "hint": "", "request_id": "7d7f0a1c2b3d4e5f8091a2b3c4d5e6f7"}
        answer = answers.setdefault(
            status_of(kind),
            {"model": ErrorAnswer, "description": "", "content": {"application/json": {"examples": {}}}},
        )
        answer["content"]["application/json"]["examples"][kind.code] = {"summary": summary, "value": example}
        answer["description"] = ", ".join(filter(None, [answer["description"], f"`{kind.code}`"]))
    return answers


def _add_common_failures(operation: dict[str, Any]) -> None:
    """Add to an operation the ``responses`` common to all: errors of keys, queries and bodies, where it has these."""
    kinds: list[type[RholocError]] = [InvalidRequest]  # unknown query parameters
    if "security" in operation:
        kinds += [Unauthorized, Forbidden, CrossSite, TooManyRequests, QuotaExceeded]
    if "requestBody" in operation:
        kinds.append(TooLarge)
    for status, common in failures(*kinds).items():
        answer = operation["responses"].setdefault(str(status), {"description": ""})
        known = answer.setdefault("content", {}).setdefault("application/json", {})
        known["schema"] = reference(ErrorAnswer)  # not the framework's own
        examples = known.setdefault("examples", {})
        examples |= common["content"]["application/json"]["examples"]
        answer["description"] = ", ".join(f"`{code}`" for code in examples)


def _describe_names(operation: dict[str, Any]) -> None:
    """Add to the names and ids in an operation's path the patterns that they match."""
    for parameter in operation.get("parameters", ()):
        if parameter["in"] == "path" and parameter["name"] in _PATTERNS:
            parameter["schema"]["pattern"] = _PATTERNS[parameter["name"]]


def install(app: FastAPI, read_by_hand: Sequence[type[BaseModel]]) -> None:
    """Serve the OpenAPI document at /openapi.json, with the models of hand-read bodies, and no errors but ours."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            schema = get_openapi(
                title=app.title,
                version=app.version,
                description=app.description,
                routes=app.routes,
                tags=app.openapi_tags,
            )
            _, definitions = models_json_schema([(model, "validation") for model in read_by_hand], ref_template=_REF)
            schema["components"]["schemas"] = {**definitions["$defs"], **schema["components"]["schemas"]}
            for own in ("HTTPValidationError", "ValidationError"):
                schema["components"]["schemas"].pop(own, None)
            for item in schema["paths"].values():
                for operation in item.values():
                    _add_common_failures(operation)
                    _describe_names(operation)
            app.openapi_schema = schema
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]

    @app.get("/openapi.json", include_in_schema=False, dependencies=[OPEN])
    async def document() -> JSONResponse:
        return JSONResponse(app.openapi())
