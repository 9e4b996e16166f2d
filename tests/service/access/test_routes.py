"""Every route with every kind of key."""

from __future__ import annotations

import base64
import json

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from tests.service.access.conftest import bearer

pytestmark = pytest.mark.anyio

OPEN = {("GET", path) for path in ("/", "/livez", "/readyz", "/v2/health/live", "/v2/health/ready", "/assets/no.js")}
ANY = {
    ("GET", "/docs"), ("GET", "/openapi.json"), ("GET", "/metrics"), ("GET", "/v1/access"),
    ("GET", "/v1/verbs"), ("GET", "/v1/verbs/{verb}"), ("GET", "/v1/verbs/{verb}/versions"),
    ("GET", "/v1/refinements"), ("GET", "/v1/refinements/{id}"), ("GET", "/v1/refinements/{id}/events"),
}  # fmt: skip
SCOPED = {
    "pose": {
        ("POST", "/v1/verbs/{verb}/pose"), ("POST", "/v1/verbs/{verb}/poses"), ("POST", "/v1/verbs/{verb}/sequence"),
        ("GET", "/v1/verbs/{verb}/quality"), ("GET", "/v1/verbs/{verb}/artifact"),
        ("GET", "/v1/verbs/{verb}/versions/{number}"),
    },
    "author": {
        ("POST", "/v1/verbs"), ("DELETE", "/v1/verbs/{verb}"), ("POST", "/v1/verbs/{verb}/examples"),
        ("POST", "/v1/verbs/{verb}/versions/{number}/activate"),
        ("GET", "/v1/drafts"), ("POST", "/v1/drafts"), ("GET", "/v1/drafts/{id}"), ("PATCH", "/v1/drafts/{id}"),
        ("DELETE", "/v1/drafts/{id}"), ("GET", "/v1/drafts/{id}/motion"), ("POST", "/v1/drafts/{id}/pose"),
        ("POST", "/v1/drafts/{id}/sequence"), ("POST", "/v1/drafts/{id}/publish"),
    },
    "refine": {("POST", "/v1/verbs/{verb}/refinements"), ("DELETE", "/v1/refinements/{id}")},
    "admin": {("GET", "/v1/audit")},
}  # fmt: skip
ROUTES = sorted(OPEN | ANY | set.union(*SCOPED.values()))
KEYS = ("none", "wrong", "malformed", "basic", "expired", "revoked", "pose", "author", "refine", "admin")


def expected(route: tuple[str, str], key: str) -> int:
    """401, 403, or 0 for a request that passes."""
    if route in OPEN:
        return 0
    if key in ("none", "wrong", "malformed", "basic", "expired", "revoked"):
        return 401
    if route in ANY or key == "admin":
        return 0
    return 0 if route in SCOPED[key] else 403


def header(key: str, keys: dict[str, str]) -> dict[str, str]:
    other = keys["pose"][:-1] + ("A" if keys["pose"][-1] != "A" else "B")
    given = {"wrong": bearer(other), "malformed": bearer("a key"), "basic": {"Authorization": "Basic YTpi"}, "none": {}}
    return given[key] if key in given else bearer(keys[key])


def test_the_table_has_every_route(guarded):
    known = {
        (method, route.path)
        for route in guarded.server.app.routes
        for method in getattr(route, "methods", None) or ()
        if method != "HEAD"
    }
    listed = {(method, "/assets/{path:path}" if "assets" in path else path) for method, path in ROUTES}
    assert listed == known


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("route", ROUTES, ids=" ".join)
async def test_each_route_with_each_key(client, guarded, route, key):
    method, path = route
    path = path.replace("{verb}", "nothing").replace("{number}", "1").replace("{id}", "0")
    answer = await client.request(method, path, headers=header(key, guarded.keys))
    refused = answer.status_code if answer.status_code in (401, 403) else 0
    assert refused == expected(route, key), answer.text[:200]
    if refused == 401:
        assert answer.headers["www-authenticate"].startswith("Bearer")
        assert answer.json()["code"] == "unauthenticated"
        assert guarded.keys["pose"] not in answer.text
    if refused == 403:
        problem = answer.json()
        assert (problem["code"], problem["scope"]) == ("missing_scope", scope_of(route))


def scope_of(route: tuple[str, str]) -> str:
    return next(scope for scope, routes in SCOPED.items() if route in routes)


async def test_a_path_without_a_rule_needs_admin(client, guarded):
    for path in ("/v1/verbs/reach/other", "/v2/models", "/v1", "/favicon.ico"):
        assert (await client.get(path)).status_code == 401
        assert (await client.get(path, headers=bearer(guarded.keys["pose"]))).status_code == 403
        assert (await client.get(path, headers=bearer(guarded.keys["admin"]))).status_code == 404


@pytest.mark.parametrize("path", ["//v1/verbs", "/v1/verbs/", "/%76%31/verbs", "/v1/verbs/../audit", "/livez/"])
async def test_other_spellings_of_a_path_open_nothing(client, path):
    answer = await client.get(path)
    assert answer.status_code in (401, 404)
    assert "verbs" not in answer.text or answer.status_code == 401


def texts(keys: dict[str, str], key: str) -> tuple[dict[str, str], list[str]]:
    """Headers and subprotocols of a handshake."""
    return header(key, keys), ["adverb.v1"]


@pytest.mark.parametrize("key", KEYS)
async def test_streams_with_each_key(guarded, key):
    status = 0
    try:
        async with connect(
            guarded.server.url, subprotocols=["adverb.v1"], additional_headers=header(key, guarded.keys)
        ):
            pass
    except InvalidStatus as err:
        status = err.response.status_code
    wanted = {"pose": 0, "admin": 0, "author": 403, "refine": 403}
    assert status == wanted.get(key, 401)


@pytest.mark.parametrize("encoded", [False, True], ids=["as it is", "encoded once more"])
async def test_a_browser_sends_the_key_as_a_subprotocol(guarded, encoded):
    key = guarded.keys["pose"]
    text = base64.urlsafe_b64encode(key.encode()).decode().rstrip("=") if encoded else key
    offered = ["adverb.v1", f"adverb.bearer.{text}"]
    async with connect(guarded.server.url, subprotocols=offered) as stream:
        assert stream.subprotocol == "adverb.v1"
        await stream.send(json.dumps({"op": "open", "channel": 1, "verb": "arm3"}))
        assert json.loads(await stream.recv())["op"]
    with pytest.raises(InvalidStatus):
        async with connect(guarded.server.url, subprotocols=["adverb.v1", "adverb.bearer.nothing"]):
            pass


async def test_two_headers_are_refused(client, guarded):
    headers = [
        ("Authorization", f"Bearer {guarded.keys['admin']}"),
        ("Authorization", f"Bearer {guarded.keys['pose']}"),
    ]
    assert (await client.get("/v1/verbs", headers=headers)).status_code == 401


@pytest.mark.parametrize("blank", ["\x85", "\xa0", "\x1c"])
async def test_only_blanks_of_the_grammar_surround_a_key(client, guarded, blank):
    key = guarded.keys["pose"]
    for text, statuses in (
        (f"Bearer {blank}{key}", {400, 401}),
        (f"Bearer {key}{blank}", {400, 401}),
        (f"Bearer  {key}", {200}),
    ):
        headers = {b"authorization": text.encode("latin-1")}
        assert (await client.get("/v1/verbs", headers=headers)).status_code in statuses


async def test_a_key_in_the_address_is_no_key(client, guarded):
    for name in ("key", "api_key", "token", "access_token"):
        assert (await client.get("/v1/verbs", params={name: guarded.keys["admin"]})).status_code == 401


async def test_access_describes_the_key(client, guarded):
    answer = (await client.get("/v1/access", headers=bearer(guarded.keys["author"]))).json()
    assert answer == {
        "required": True,
        "id": guarded.keys["author"].split("_")[1],
        "name": "of author",
        "scopes": ["author"],
        "expires_at": None,
    }
