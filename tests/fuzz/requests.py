"""Targets that read requests: JSON bodies, headers, keys and tokens, by functions and through the app."""

from __future__ import annotations

import asyncio
import json
from base64 import urlsafe_b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import structlog
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from fastapi.exceptions import RequestValidationError
from jwt.algorithms import OKPAlgorithm
from pydantic import BaseModel, ValidationError
from starlette.requests import Request

from service import errors
from service.access.tokens import Tokens
from service.app import create_app
from service.catalog import catalog as catalogs
from service.errors import ServiceError, Unauthenticated
from service.http import draft_models, negotiation, request_models
from service.http.routes import drafts, pages
from service.settings import Settings
from tests.fuzz.files import GOLDEN, folder
from verbs.errors import RequestError
from verbs.io import artifact

Run = Callable[[bytes], None]
Headers = list[tuple[bytes, bytes]]

CONTENT = b"0123456789" * 10


@cache
def catalog() -> Any:
    """The built-in verbs, and the arm of the golden file."""
    with folder() as place:
        artifact.save(artifact.load(GOLDEN / "arm.v1.verb"), place / "arm.verb")
        return catalogs.load(place)


def quiet() -> None:
    """Discard log entries, except that one of an exception fails the target."""

    def drop(_: object, method: str, event: dict[str, Any]) -> Any:
        if event.get("exc_info"):
            raise AssertionError(f"{event.get('event')}: an exception was logged")
        raise structlog.DropEvent

    structlog.configure(processors=[drop])


class Server:
    """An app without a socket: requests in ASGI, on an event loop of its own."""

    def __init__(self, **settings: Any) -> None:
        self._logging = structlog.get_config()
        quiet()
        self.loop = asyncio.new_event_loop()
        self.app = create_app(Settings(**settings))
        self.app.state.server.set_catalog(catalog())

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.loop.close()
        structlog.configure(**self._logging)

    def request(self, method: str, path: str, headers: Headers, body: bytes = b"") -> tuple[int, bytes]:
        """Status and body of a response, which is a documented one: not 500, and a problem where it is no success."""
        given = [{"type": "http.request", "body": body, "more_body": False}]
        sent: list[Any] = []

        async def receive() -> Any:
            return given.pop() if given else await asyncio.Event().wait()

        async def send(message: Any) -> None:
            sent.append(message)

        scope = {
            **{"type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "scheme": "http"},
            **{"method": method, "path": path, "raw_path": path.encode(), "query_string": b"", "root_path": ""},
            **{"headers": [(b"host", b"localhost"), *headers], "client": ("127.0.0.1", 1)},
            **{"server": ("localhost", 80), "state": {}},
        }
        self.loop.run_until_complete(self.app(scope, receive, send))
        status, content = sent[0]["status"], b"".join(message.get("body", b"") for message in sent[1:])
        assert status != 500, content
        if status >= 400 and path.startswith("/v1"):
            assert json.loads(content)["code"]
        return status, content


# ── bodies ───────────────────────────────────────────────────────────────────────────────────────────────────────────

MODELS: tuple[type[BaseModel], ...] = (
    request_models.PoseRequest,
    request_models.BatchRequest,
    request_models.SequenceRequest,
    request_models.RefinementRequest,
    draft_models.DraftChange,
    draft_models.DraftPublication,
)

ROUTES = ("/v1/verbs/arm/pose", "/v1/verbs/arm/poses", "/v1/verbs/arm/sequence", "/v1/verbs/arm/refinements")
_JSON = (b"content-type", b"application/json")

_BODIES = (
    {"adverbs": {"x": 0.4, "y": 0.3}, "phase": 0.5, "space": "global", "frame": "unity", "joints": ["Hand"]},
    {"items": [{"adverbs": {"x": 0.4, "y": 0.3}, "phase": 0.1}, {"adverbs": {"x": 1e3, "y": 0.3}, "keytime": "reach"}]},
    {"adverbs": {"x": 0.4, "y": 0.3}, "fps": 30, "frames": 9, "method": "corrected", "phase": [0.0, 1.0]},
    {"track": [{"t": 0.0, "adverbs": {"x": 0.4, "y": 0.3}}, {"t": 0.1, "adverbs": {"x": 0.5, "y": 0.3}}], "fps": 30},
    {"budget_s": 1, "purpose": "quality", "target": 0.01, "seed": 1},
    {"name": "a", "adverbs": [{"name": "x", "unit": "m"}], "clips": [{"name": "c", "keytimes": [0, 1]}]},
)


@contextmanager
def read_models() -> Iterator[Run]:
    """First byte: which model; the rest is a body."""
    responses = (errors.BadBody, RequestValidationError)

    def run(data: bytes) -> None:
        model = MODELS[data[0] % len(MODELS)] if data else MODELS[0]
        try:
            model.model_validate_json(data[1:])
        except ValidationError as err:
            with pytest.raises(responses) as wrong:
                errors.invalid(err, model)
            assert 400 <= errors.response_of(wrong.value).status_code < 500

    yield run


@contextmanager
def read_bodies() -> Iterator[Run]:
    """First byte: which route; the rest is a body."""
    with Server() as server:

        def run(data: bytes) -> None:
            path = ROUTES[data[0] % len(ROUTES)] if data else ROUTES[0]
            server.request("POST", path, [_JSON], data[1:])

        for kind in range(3):
            for body in _BODIES:
                run(bytes([kind]) + json.dumps(body).encode())
        yield run


def body_seeds() -> Iterator[bytes]:
    """Bodies of every route, each for every model."""
    for kind in range(len(MODELS)):
        for body in _BODIES:
            yield bytes([kind]) + json.dumps(body).encode()
    yield b"\0" + b"[" * 300
    yield b'\0{"adverbs": {"x": 1e999, "y": NaN, "\\ud800": -0}}'


# ── headers ──────────────────────────────────────────────────────────────────────────────────────────────────────────

HEADERS = (b"range", b"if-range", b"if-match", b"if-none-match", b"accept", b"content-type", b"host", b"origin")
_REQUESTS = (("GET", "/assets/a.js"), ("GET", "/v1/verbs/arm"), ("POST", "/v1/verbs/arm/pose"), ("GET", "/"))


def _value(data: bytes) -> bytes:
    """What the HTTP parser lets through in a header."""
    return data.translate(None, b"\r\n\0").strip()


def _header(data: bytes) -> tuple[bytes, bytes]:
    return HEADERS[data[0] % len(HEADERS)] if data else HEADERS[0], _value(data[1:])


def _check_refusal(err: Exception) -> None:
    assert 400 <= errors.response_of(err).status_code < 500


@contextmanager
def read_headers() -> Iterator[Run]:
    """First byte: which header; the rest is its value."""

    def run(data: bytes) -> None:
        name, value = _header(data)
        request = Request({"type": "http", "headers": [(name, value)]})
        for read in (
            lambda: negotiation.if_match(request, "draft"),
            lambda: negotiation.accepted(request, negotiation.JSON, negotiation.OCTETS, negotiation.BVH),
            lambda: negotiation.media_type(request, negotiation.JSON, negotiation.ZIP),
            lambda: drafts._known(request, "1"),
            lambda: drafts.numbers(value.decode("latin-1")),
        ):
            try:
                read()
            except (ServiceError, RequestError) as err:
                _check_refusal(err)

    yield run


@contextmanager
def request_headers() -> Iterator[Run]:
    """The same through the app, by four routes."""
    static = pages.STATIC
    with folder() as place, Server() as server:
        (place / "assets").mkdir()
        (place / "assets" / "a.js").write_bytes(CONTENT)
        (place / "index.html").write_bytes(CONTENT)
        pages.STATIC = place
        body = json.dumps({"adverbs": {"x": 0.4, "y": 0.3}}).encode()

        def run(data: bytes) -> None:
            name, value = _header(data)
            for method, path in _REQUESTS:
                headers = [(name, value)] if name == b"content-type" else [(name, value), _JSON]
                if name == b"if-range":
                    headers.append((b"range", b"bytes=1-2"))
                status, content = server.request(method, path, headers, body if method == "POST" else b"")
                assert status != 200 or not path.startswith("/assets") or content == CONTENT
                assert status != 206 or len(content) <= 64 * len(CONTENT)

        try:
            yield run
        finally:
            pages.STATIC = static


def header_seeds() -> Iterator[bytes]:
    """Values of each header, valid and nearly so."""
    values = (
        (
            b"bytes=0-9",
            b"bytes=-5",
            b"bytes=90-",
            b"bytes=0-1,3-4,7-,-1",
            b"bytes=9-1",
            b"bytes=" + b"0-," * 60,
            b"x=1-2",
        ),
        (b'"a"', b"Wed, 21 Oct 2015 07:28:00 GMT"),
        (b'"1"', b'W/"12"', b"*", b'"999999999"', b'"1", "2"', b"\xb2\xb3"),
        (b'"1"', b'W/"a", "b"', b"*", b", " * 50),
        (b"application/json", b"text/*;q=0.5, */*;q=0.1", b"a/b;q=nan, application/*;q=1e9", b"*/*;q=" + b"9" * 99),
        (b"application/json; charset=utf-8", b"application/zip", b"a/b", b";"),
        (b"localhost:8000", b"[::1]:80", b"127.0.0.1", b"a.example", b"[", b"localhost:99999"),
        (b"http://localhost", b"null", b"http://[::1]:80", b"https://a.example:443", b"http://["),
    )
    for kind, listed in enumerate(values):
        for value in listed:
            yield bytes([kind]) + value


# ── keys and tokens ──────────────────────────────────────────────────────────────────────────────────────────────────

_SIGNER = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))


def _key_set(place: Path) -> str:
    row = json.loads(OKPAlgorithm.to_jwk(_SIGNER.public_key())) | {"kid": "k", "alg": "EdDSA", "use": "sig"}
    (place / "keys.json").write_text(json.dumps({"keys": [row]}))
    return str(place / "keys.json")


def _text(data: bytes) -> bytes:
    return urlsafe_b64encode(data).rstrip(b"=")


def _signed(header: bytes, claims: bytes) -> bytes:
    signed = _text(header) + b"." + _text(claims)
    return signed + b"." + _text(_SIGNER.sign(signed))


@contextmanager
def read_tokens() -> Iterator[Run]:
    """0: the text of a token; 1: header and, after a zero byte, claims, which are encoded and signed."""
    loop = asyncio.new_event_loop()
    with folder() as place:
        tokens = Tokens(_key_set(place), issuer="game", audience="adverb", scope_claim="scope")

        def run(data: bytes) -> None:
            header, _, claims = data[1:].partition(b"\0")
            text = _signed(header, claims) if data[:1] == b"1" else _text(header) + b"." + claims
            try:
                _, scopes, _ = loop.run_until_complete(tokens.verify(text.decode("latin-1")))
                assert scopes <= {"pose", "author", "refine", "admin"}
            except Unauthenticated:
                pass

        yield run
    loop.close()


def token_seeds() -> Iterator[bytes]:
    """Headers and claims."""
    header = b'{"alg": "EdDSA", "typ": "JWT", "kid": "k"}'
    claims = {"iss": "game", "aud": "adverb", "sub": "p", "exp": 4_000_000_000, "nbf": 1, "iat": 1, "scope": "pose"}
    yield b"1" + header + b"\0" + json.dumps(claims).encode()
    yield b"1" + header + b"\0" + json.dumps(claims | {"aud": ["adverb"], "scope": ["pose", 1]}).encode()
    yield b'1{"alg": "EdDSA"}\0{"exp": 1e99, "aud": {}}'
    yield b'1{"alg": "none"}\0{}'
    yield b'1{"alg": ["EdDSA"], "kid": {}, "crit": ["b64"], "b64": false}\0[]'
    yield b"0" + header + b"\0e30.AAAA"
    yield b'0{"a":' + b"[" * 900 + b"\0"


@contextmanager
def authenticate() -> Iterator[Run]:
    """0: an Authorization header; 1: the text after ``Bearer``; 2: a handshake's subprotocols, by commas."""
    with folder() as place, Server(keys="required", jwt_jwks=_key_set(place)) as server:

        def run(data: bytes) -> None:
            kind, value = data[:1], _value(data[1:])
            if kind == b"2":
                offered = [part.strip() for part in value.decode("latin-1").split(",")]
                keys = [text.partition("adverb.bearer.")[2].encode("latin-1") for text in offered]
                assert _handshake(server, offered) == 401 or any(map(_is_signed, keys))
                return
            header = value if kind == b"0" else b"Bearer " + value
            status, _ = server.request("GET", "/v1/verbs", [(b"authorization", header)])
            assert status in (200, 401, 503)
            assert status != 200 or _is_signed(header)

        yield run


def _is_signed(header: bytes) -> bool:
    """Whether a header can be that of a valid token: the signer signs only what is generated here."""
    return header.split(b" ")[-1].startswith(_text(b'{"alg": "EdDSA"}'))


def _handshake(server: Server, offered: list[str]) -> int:
    """Status of the response."""
    given: list[Any] = [{"type": "websocket.disconnect", "code": 1000}, {"type": "websocket.connect"}]
    sent: list[Any] = []

    async def receive() -> Any:
        return given.pop() if given else await asyncio.Event().wait()

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        **{
            "type": "websocket",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "scheme": "ws",
            "path": "/v1/stream",
        },
        **{"raw_path": b"/v1/stream", "query_string": b"", "root_path": "", "subprotocols": offered, "state": {}},
        **{"headers": [(b"host", b"localhost")], "client": ("127.0.0.1", 1), "server": ("localhost", 80)},
        **{"extensions": {"websocket.http.response": {}}},
    }
    server.loop.run_until_complete(server.app(scope, receive, send))
    return 101 if sent[0]["type"] == "websocket.accept" else int(sent[0]["status"])


def authorization_seeds() -> Iterator[bytes]:
    """Keys, tokens, other schemes; keys encoded once more."""
    key = b"adv_0123456789abcdef_" + b"a" * 43
    valid = _signed(b'{"alg": "EdDSA"}', b'{"exp": 4000000000, "scope": "pose"}')
    yield b"0Bearer " + key
    yield b"0Basic dXNlcjpwYXNz"
    yield b"0bearer  " + valid
    for text in (key, valid, _text(key), _text(b"{" * 50), b"\xb2.\xff.", b"a" * 900):
        yield b"1" + text
        yield b"2adverb.v1, adverb.bearer." + text
    yield b"1" + _text(b'{"a":' + b"[" * 3_000) + b".."
    yield b"2adverb.bearer.,adverb.bearer.x"
