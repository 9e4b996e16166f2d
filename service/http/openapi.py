"""OpenAPI document: FastAPI's, with the request bodies that handlers validate and the stream messages."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from service.access import scopes
from service.http import draft_models, request_models, response_models
from service.http.documented import problems
from service.stream import messages

__all__ = ["API_VERSION", "DESCRIPTION", "install"]

API_VERSION = "1"

DESCRIPTION = (
    "Example motions in, any motion in between out, with its measured error. Right-handed, +Y up, +Z forward, +X left; "
    "metres, seconds, radians; quaternions x, y, z, w. Errors are RFC 9457 problems with a stable `code`."
)

_KEY = "Needed where a key exists, or other machines can reach the server. `adverb keys create` makes one."

_VALIDATED_BY_HANDLERS = (
    request_models.PoseRequest,
    request_models.BatchRequest,
    request_models.SequenceRequest,
    request_models.RefinementRequest,
    draft_models.DraftChange,
    draft_models.DraftPublication,
    response_models.ProblemAnswer,
)


def install(app: FastAPI) -> None:
    """Serve the complete document at ``/openapi.json``, generated once."""

    def whole() -> dict[str, Any]:
        if not app.openapi_schema:
            app.openapi_schema = _document(app)
        return app.openapi_schema

    app.openapi = whole  # type: ignore[method-assign]


def _document(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes, tags=app.openapi_tags
    )
    known = document.setdefault("components", {}).setdefault("schemas", {})
    for name, adapter in (("ClientMessage", messages.CLIENT), ("ServerMessage", messages.SERVER)):
        union = adapter.json_schema(ref_template="#/components/schemas/{model}")
        for part, schema in union.pop("$defs").items():
            known.setdefault(part, schema)
        known[name] = union
    _, definitions = models_json_schema(
        [(model, "validation") for model in _VALIDATED_BY_HANDLERS], ref_template="#/components/schemas/{model}"
    )
    for name, schema in definitions["$defs"].items():
        known.setdefault(name, schema)
    known_schemes = document["components"].setdefault("securitySchemes", {})
    known_schemes["key"] = {"type": "http", "scheme": "bearer", "description": _KEY}
    for name, path in document["paths"].items():
        for method, operation in path.items():
            _correct(operation)
            _secure(operation, scopes.needed(method.upper(), name))
            guarded = ("unknown_host",) if method == "get" else ("unknown_host", "foreign_origin")
            for status, response in problems(*guarded).items():
                operation["responses"].setdefault(str(status), response)
    return document


def _secure(operation: dict[str, Any], needed: str) -> None:
    """Document the scope that a route needs, where the server requires keys."""
    if needed == scopes.OPEN:
        return
    operation["security"] = [{}, {"key": []}]
    special = (scopes.ANY, scopes.DOCS, scopes.METRICS)
    operation["description"] += "\n\nScope: " + (f"`{needed}`." if needed not in special else "any.")
    codes = ("unauthenticated",) if needed in special else ("unauthenticated", "missing_scope")
    for status, response in problems(*codes).items():
        operation["responses"].setdefault(str(status), response)


def _correct(operation: dict[str, Any]) -> None:
    """Document invalid parameters as problems instead of FastAPI's error model."""
    responses = operation["responses"]
    default = responses.get("422", {}).get("content", {})
    if "application/json" in default:
        del default["application/json"]
        default["application/problem+json"] = {"schema": {"$ref": "#/components/schemas/ProblemAnswer"}}
