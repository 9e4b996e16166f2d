"""Parts of the OpenAPI document that several routes share."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Path
from pydantic import BaseModel

from service.errors import MEDIA_TYPE, PROBLEMS
from service.http.negotiation import JSON

__all__ = ["EVALUATING", "READING", "VerbName", "body", "forms", "problems"]

VerbName = Annotated[str, Path(description="Name of a verb, as `GET /v1/verbs` lists them.", examples=["reach"])]

READING = ("unknown_verb", "not_ready")
EVALUATING = (
    *READING,
    "malformed_body",
    "unknown_version",
    "not_acceptable",
    "body_too_large",
    "batch_too_large",
    "unsupported_media_type",
    "invalid_request",
    "overloaded",
    "store_unavailable",
    "artifact_damaged",
)
"""Problem codes of routes that read, and of routes that evaluate."""


def problems(*codes: str) -> dict[int | str, dict[str, Any]]:
    """Problem responses for the OpenAPI document, by status; what needs the store may also be overloaded."""
    rows: dict[int | str, dict[str, Any]] = {}
    for code in dict.fromkeys([*codes, *(["overloaded"] if "store_unavailable" in codes else [])]):
        row = PROBLEMS[code]
        known = rows.setdefault(row.status, {"description": row.title, "content": {MEDIA_TYPE: {"schema": _PROBLEM}}})
        if row.title not in known["description"]:
            known["description"] += f"; {row.title.lower()}"
    return rows


def forms(*others: str) -> dict[int | str, dict[str, Any]]:
    """Successful responses of other media types than JSON."""
    return {200: {"content": {form: {"schema": _schema(form)} for form in others}}}


def body(model: type[BaseModel], *others: str) -> dict[str, Any]:
    """A request body that the handler reads and validates."""
    content: dict[str, Any] = {JSON: {"schema": {"$ref": f"#/components/schemas/{model.__name__}"}}}
    content |= {form: {"schema": _schema(form)} for form in others}
    return {"requestBody": {"required": True, "content": content}}


_PROBLEM = {"$ref": "#/components/schemas/ProblemAnswer"}


def _schema(form: str) -> dict[str, str]:
    return {"type": "string"} if form.startswith("text/") else {"type": "string", "format": "binary"}
