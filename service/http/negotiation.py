"""Content negotiation and request bodies: media types, JSON models, large JSON responses in slices."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from functools import lru_cache
from typing import TypeVar

import anyio.lowlevel
from pydantic import BaseModel, ValidationError
from starlette.requests import ClientDisconnect, Request
from starlette.responses import StreamingResponse

from service import errors
from verbs.errors import RequestError

__all__ = [
    "BVH",
    "FILES",
    "GLB",
    "JSON",
    "NPZ",
    "OBJECT_BYTES",
    "OCTETS",
    "VRMA",
    "ZIP",
    "accepted",
    "header",
    "if_match",
    "media_type",
    "parsed",
    "read",
    "read_model",
    "sliced",
]

JSON, OCTETS, BVH = "application/json", "application/octet-stream", "text/x-bvh"
GLB, VRMA, NPZ = "model/gltf-binary", "application/x-vrma", "application/x-npz"
ZIP = "application/zip"

FILES = {BVH: "bvh", GLB: "glb", VRMA: "vrma", NPZ: "npz"}
"""Media types of motion files, with their format. No type is registered for VRM animations and NumPy archives."""

OBJECT_BYTES = 64 * 1024
"""Longest JSON body of a route that reads one object: parsing one of wrong fields takes 1 ms, of 1 MiB 30 ms."""

Model = TypeVar("Model", bound=BaseModel)


def header(request: Request, name: bytes) -> bytes:
    """Value of a header, or empty bytes; faster than a mapping for the two headers that a pose needs."""
    for key, value in request.scope["headers"]:
        if key == name:
            return bytes(value)
    return b""


def media_type(request: Request, *known: str) -> str:
    """Media type of the body; raises :class:`errors.WrongMediaType` with the types that the route reads."""
    given = header(request, b"content-type")
    found = _essence(given)
    if found not in known:
        kind = f"'{found[:80]}'" if found else "of no stated type"
        raise errors.WrongMediaType(f"the body is {kind}; send Content-Type: {' or '.join(known)}", known=list(known))
    return found


def accepted(request: Request, *offers: str) -> str:
    """Media type of the response that the client prefers; of equal ones the first that is offered.

    Raises :class:`errors.NotAcceptable` with the media types that the route offers.
    """
    chosen = _best(header(request, b"accept")[:1_000], offers)
    if chosen is None:
        raise errors.NotAcceptable(f"this route offers {', '.join(offers)}; accept one of them", known=list(offers))
    return chosen


def if_match(request: Request, what: str) -> int | None:
    """Number of ``If-Match``; None if it is absent or ``*``; raises :class:`verbs.errors.RequestError`."""
    given = header(request, b"if-match").decode("latin-1").strip()
    if given in ("", "*"):
        return None
    number = given.removeprefix("W/").strip('"')
    if not number.isdecimal() or len(number) > 9:
        raise RequestError(f"If-Match is {given[:40]}; it must be the number of a {what} in quotes, or *")
    return int(number)


async def read(request: Request) -> bytes:
    """Read the whole body, whose length the middleware bounds; a body in one piece is not copied."""
    parts = []
    while True:
        message = await request.receive()
        if message["type"] == "http.disconnect":
            raise ClientDisconnect
        parts.append(message.get("body", b""))
        if not message.get("more_body", False):
            return parts[0] if len(parts) == 1 else b"".join(parts)


async def read_model(request: Request, model: type[Model], *, most: int | None = None) -> Model:
    """Read and validate the JSON body; of at most so many bytes where it is one object, since parsing blocks others.

    The model is parsed from bytes. Parsing to Python objects first, as FastAPI does for declared bodies, takes longer
    and accepts ``NaN``.
    """
    media_type(request, JSON)
    content = await read(request)
    if most is not None and len(content) > most:
        raise errors.BodyTooLarge(f"the JSON body of this route may have at most {most} bytes", limit=most)
    return parsed(content, model)


def parsed(content: bytes, model: type[Model]) -> Model:
    """Validate a JSON body."""
    try:
        return model.model_validate_json(content)
    except ValidationError as err:
        errors.invalid(err, model)


def sliced(parts: Iterable[bytes]) -> StreamingResponse:
    """A large JSON response, sent in slices; other requests run between two slices."""

    async def stream() -> AsyncIterator[bytes]:
        for part in parts:
            yield part
            await anyio.lowlevel.checkpoint()

    return StreamingResponse(stream(), media_type=JSON)


@lru_cache(maxsize=256)
def _essence(content_type: bytes) -> str:
    """``application/json`` of ``Application/JSON; charset=utf-8``."""
    return content_type.split(b";", 1)[0].strip().lower().decode("latin-1")


@lru_cache(maxsize=256)
def _best(accept: bytes, offers: tuple[str, ...]) -> str | None:
    """The offer of the highest quality in an Accept header (RFC 9110, 12.5.1); None where none is accepted."""
    if not accept.strip():
        return offers[0]
    ranges = [_media_range(part) for part in accept.decode("latin-1").lower().split(",") if part.strip()]
    best, best_quality = None, 0.0
    for offer in offers:
        fits = [(len(text.replace("*", "")), quality) for text, quality in ranges if _covers(text, offer)]
        quality = max(fits)[1] if fits else 0.0  # the most specific range decides
        if quality > best_quality:
            best, best_quality = offer, quality
    return best


def _media_range(text: str) -> tuple[str, float]:
    kind, *parameters = (part.strip() for part in text.split(";"))
    for parameter in parameters:
        if parameter.startswith("q="):
            try:
                return kind, min(max(float(parameter[2:]), 0.0), 1.0)
            except ValueError:
                return kind, 0.0
    return kind, 1.0


def _covers(media_range: str, offer: str) -> bool:
    return media_range in ("*/*", offer) or (media_range.endswith("/*") and offer.startswith(media_range[:-1]))
