"""Operations that change verbs: versions, refinements, drafts, and the list of changes; without I/O, as in ``api``.

What changes something is sent once: after status 503 it may have been done.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeVar
from urllib.parse import quote

from adverb_client.api import JSON, OCTETS, Operation, Request, path_of, send
from adverb_client.authoring_models import Access, Change, Draft, DraftSummary, Refinement, Version
from adverb_client.parsing import parse_json

__all__ = ["AuthoringApi"]

ZIP, ZIP_START = "application/zip", b"PK"

BUILD_S = 300.0
"""Time-out of requests in which the server may build a verb, seconds."""

T = TypeVar("T")
Method = Literal["POST", "PATCH", "DELETE"]
Query = tuple[tuple[str, str], ...]


class AuthoringApi:
    """The operations; each is a generator that yields requests and receives responses."""

    def versions(self, verb: str) -> Operation[tuple[Version, ...]]:
        """The versions of a verb, the newest first."""
        return (yield from _get(path_of(verb, "versions"), lambda fields: _all(Version.of_json, fields["versions"])))

    def upload(self, content: bytes, expected: int | None) -> Operation[Version]:
        """Publish an artifact, or a zip of a source."""
        kind = ZIP if content.startswith(ZIP_START) else OCTETS
        return (yield from _changed("POST", "/v1/verbs", Version.of_json, content, kind, expected))

    def add_example(
        self,
        verb: str,
        content: bytes,
        file: str,
        keytimes: Sequence[float] | None,
        style: Mapping[str, float],
        expected: int | None,
    ) -> Operation[Version]:
        """Publish a version with one more example."""
        query = [("file", file), *(("style", f"{name}:{float(value)!r}") for name, value in style.items())]
        if keytimes is not None:
            query.append(("keytimes", _numbers(keytimes)))
        path = path_of(verb, "examples")
        return (yield from _changed("POST", path, Version.of_json, content, OCTETS, expected, tuple(query)))

    def activate(self, verb: str, number: int, expected: int | None) -> Operation[Version]:
        """Serve another version."""
        path = path_of(verb, f"versions/{int(number)}/activate")
        return (yield from _changed("POST", path, Version.of_json, expected=expected))

    def delete(self, verb: str, expected: int | None) -> Operation[None]:
        """Stop serving a verb."""
        headers = {} if expected is None else {"if-match": f'"{int(expected)}"'}
        yield from send(Request("DELETE", path_of(verb), headers=headers, retry=False))

    def download(self, verb: str, number: int) -> Operation[bytes]:
        """The artifact of a version."""
        return (yield from send(Request("GET", path_of(verb, f"versions/{int(number)}"), OCTETS))).content

    def refine(self, verb: str, options: Mapping[str, Any]) -> Operation[Refinement]:
        """Start a refinement."""
        path = path_of(verb, "refinements")
        return (yield from _changed("POST", path, Refinement.of_json, _body(options), JSON))

    def refinement(self, id: str) -> Operation[Refinement]:
        """One refinement."""
        return (yield from _get(f"/v1/refinements/{_quoted(id)}", Refinement.of_json))

    def refinements(self, verb: str | None, limit: int) -> Operation[tuple[Refinement, ...]]:
        """The newest refinements."""
        query = (("limit", str(limit)), *((("verb", verb),) if verb else ()))
        return (
            yield from _get("/v1/refinements", lambda fields: _all(Refinement.of_json, fields["refinements"]), query)
        )

    def cancel_refinement(self, id: str) -> Operation[Refinement]:
        """Cancel a refinement."""
        return (yield from _changed("DELETE", f"/v1/refinements/{_quoted(id)}", Refinement.of_json))

    def create_draft(self, content: bytes, options: Mapping[str, Any]) -> Operation[Draft]:
        """Make a draft of a zip of motion files."""
        query = tuple((name, text) for name, value in options.items() for text in _texts(name, value))
        return (yield from _changed("POST", "/v1/drafts", Draft.of_json, content, ZIP, query=query))

    def drafts(self) -> Operation[tuple[DraftSummary, ...]]:
        """The drafts, the last changed first."""
        return (yield from _get("/v1/drafts", lambda fields: _all(DraftSummary.of_json, fields["drafts"])))

    def draft(self, id: str) -> Operation[Draft]:
        """One draft."""
        return (yield from _get(f"/v1/drafts/{_quoted(id)}", Draft.of_json))

    def change_draft(self, id: str, changes: Mapping[str, Any], revision: int | None) -> Operation[Draft]:
        """Change a draft."""
        path = f"/v1/drafts/{_quoted(id)}"
        return (yield from _changed("PATCH", path, Draft.of_json, _body(changes), JSON, revision))

    def publish_draft(self, id: str, name: str | None, revision: int | None) -> Operation[Version]:
        """Publish the verb of a draft."""
        content = _body({"name": name} if name else {})
        path = f"/v1/drafts/{_quoted(id)}/publish"
        return (yield from _changed("POST", path, Version.of_json, content, JSON, revision))

    def delete_draft(self, id: str) -> Operation[None]:
        """Remove a draft."""
        yield from send(Request("DELETE", f"/v1/drafts/{_quoted(id)}", retry=False))

    def changes(
        self, verb: str | None, author: str | None, before: int | None, limit: int
    ) -> Operation[tuple[Change, ...]]:
        """The newest changes of verbs."""
        given = {"verb": verb, "author": author, "before": before, "limit": limit}
        query = tuple((name, str(value)) for name, value in given.items() if value is not None)
        return (yield from _get("/v1/audit", lambda fields: _all(Change.of_json, fields["changes"]), query))

    def access(self) -> Operation[Access]:
        """The key of this client."""
        return (yield from _get("/v1/access", Access.of_json))


def _all(of_json: Callable[[Any], T], rows: Sequence[Any]) -> tuple[T, ...]:
    return tuple(of_json(row) for row in rows)


def _get(path: str, build: Callable[[Any], T], query: Query = ()) -> Operation[T]:
    return parse_json((yield from send(Request("GET", path, query=query))).content, build)


def _changed(
    method: Method,
    path: str,
    build: Callable[[Any], T],
    content: bytes = b"",
    kind: str | None = None,
    expected: int | None = None,
    query: Query = (),
) -> Operation[T]:
    """A request that changes something: sent once, and with time for a build."""
    headers = {} if expected is None else {"if-match": f'"{int(expected)}"'}
    request = Request(method, path, JSON, content, kind, query, headers, retry=False, timeout_s=BUILD_S)
    return parse_json((yield from send(request)).content, build)


def _body(fields: Mapping[str, Any]) -> bytes:
    return json.dumps(fields, allow_nan=False).encode()


def _quoted(id: str) -> str:
    return quote(id, safe="")


def _numbers(values: Sequence[float]) -> str:
    return ",".join(repr(float(value)) for value in values)


def _texts(name: str, value: Any) -> list[str]:
    """Values of an option in the query."""
    if name == "annotated":
        return [f"{file}@{_numbers(times)}" for file, times in value.items()]
    if name == "keytime_names":
        return [",".join(value)]
    return [str(value)]
