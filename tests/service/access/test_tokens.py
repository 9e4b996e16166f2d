"""Tokens of another issuer, signed with real keys."""

from __future__ import annotations

import base64
import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from jwt.algorithms import ECAlgorithm, RSAAlgorithm

from service.access import tokens as module
from service.access.access import Access
from service.settings import Settings
from service.store.keys import open_keys
from tests.service.access.conftest import added, bearer
from tests.service.conftest import app_of, client_of

pytestmark = pytest.mark.anyio

ISSUER, AUDIENCE = "https://game.example", "adverb"


@pytest.fixture(scope="module")
def signers():
    return {
        "rsa": ("RS256", rsa.generate_private_key(65537, 2048)),
        "ec": ("ES256", ec.generate_private_key(ec.SECP256R1())),
        "other": ("RS256", rsa.generate_private_key(65537, 2048)),
    }


def key_set(signers, *names: str) -> str:
    rows = []
    for name in names:
        algorithm, private = signers[name]
        form = RSAAlgorithm if algorithm == "RS256" else ECAlgorithm
        rows.append(json.loads(form.to_jwk(private.public_key())) | {"kid": name, "alg": algorithm, "use": "sig"})
    return json.dumps({"keys": rows})


@pytest.fixture
def app(catalog, signers, tmp_path):
    path = tmp_path / "keys.json"
    path.write_text(key_set(signers, "rsa", "ec"))
    return app_of(catalog, jwt_jwks=str(path), jwt_issuer=ISSUER, jwt_audience=AUDIENCE)


def token(signers, name="rsa", *, kid=None, **claims) -> str:
    algorithm, private = signers[name]
    given = {"iss": ISSUER, "aud": AUDIENCE, "sub": "player 1", "exp": time.time() + 60, "scope": "pose"} | claims
    given = {claim: value for claim, value in given.items() if value is not None}
    return jwt.encode(given, private, algorithm=algorithm, headers={"kid": kid or name})


@pytest.mark.parametrize("name", ["rsa", "ec"])
@pytest.mark.parametrize("scope", ["pose", "author pose", ["pose"]])
async def test_a_token_of_the_issuer_is_accepted(app, signers, name, scope):
    async with client_of(app) as client:
        for _ in range(2):  # the second time from memory
            answer = await client.get("/v1/access", headers=bearer(token(signers, name, scope=scope)))
            assert answer.status_code == 200, answer.text
            assert answer.json()["id"] == "player 1"
            assert "pose" in answer.json()["scopes"]


async def test_scopes_of_a_token_count(app, signers):
    async with client_of(app) as client:
        given = bearer(token(signers, scope="refine unknown"))
        assert (await client.get("/v1/access", headers=given)).json()["scopes"] == ["refine"]
        answer = await client.post("/v1/verbs/arm3/pose", json={"adverbs": {"x": 0.4, "y": 0.2}}, headers=given)
        assert answer.status_code == 403
        given = bearer(token(signers, scope=None))
        assert (await client.get("/v1/access", headers=given)).json()["scopes"] == []


@pytest.mark.parametrize(
    ("claims", "reason"),
    [
        ({"exp": 1_000_000.0}, "expired"),
        ({"exp": None}, "exp"),
        ({"iss": "https://other.example"}, "ssuer"),
        ({"aud": "other"}, "udience"),
        ({"aud": None}, "aud"),
        ({"nbf": time.time() + 3_600}, "not yet valid"),
    ],
)
async def test_a_token_with_wrong_claims_is_refused(app, signers, claims, reason):
    async with client_of(app) as client:
        answer = await client.get("/v1/verbs", headers=bearer(token(signers, **claims)))
    assert answer.status_code == 401
    assert reason in answer.json()["detail"]


async def test_forged_tokens_are_refused(app, signers):
    public = signers["rsa"][1].public_key()
    claims = {"iss": ISSUER, "aud": AUDIENCE, "exp": time.time() + 60, "scope": "admin"}
    forged = [
        token(signers, "other", kid="rsa"),  # of another key
        token(signers, "other"),  # of an unknown key
        jwt.encode(claims, None, algorithm="none", headers={"kid": "rsa"}),
        jwt.encode(claims, str(public.public_numbers().n)[:64], algorithm="HS256", headers={"kid": "rsa"}),
        token(signers)[:-4] + "AAAA",
        "a.b.c",
        "..",
        "",
        "x" * 10_000,
    ]
    async with client_of(app) as client:
        for text in forged:
            answer = await client.get("/v1/verbs", headers=bearer(text))
            assert answer.status_code == 401, text
            assert answer.json()["code"] == "unauthenticated"


async def test_a_token_stops_when_it_expires(app, signers, monkeypatch):
    text = token(signers)
    async with client_of(app) as client:
        assert (await client.get("/v1/verbs", headers=bearer(text))).status_code == 200
        later = time.time() + 120
        monkeypatch.setattr(module.time, "time", lambda: later)
        assert (await client.get("/v1/verbs", headers=bearer(text))).status_code == 401


async def test_keys_of_an_address_are_read_again_when_they_change(catalog, signers, monkeypatch):
    published = [key_set(signers, "rsa")]

    class Issuer(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()
            self.wfile.write(published[0].encode())

        def log_message(self, *_):
            pass

    monkeypatch.setattr(module, "EARLIEST_S", 0.0)
    with ThreadingHTTPServer(("127.0.0.1", 0), Issuer) as issuer:
        thread = threading.Thread(target=issuer.serve_forever, daemon=True)
        thread.start()
        app = app_of(catalog, jwt_jwks=f"http://127.0.0.1:{issuer.server_port}/keys", jwt_issuer=ISSUER)
        async with client_of(app) as client:
            assert (await client.get("/v1/verbs", headers=bearer(token(signers)))).status_code == 200
            assert (await client.get("/v1/verbs", headers=bearer(token(signers, "ec")))).status_code == 401
            published[0] = key_set(signers, "ec")
            assert (await client.get("/v1/verbs", headers=bearer(token(signers, "ec")))).status_code == 200
            assert (await client.get("/v1/verbs", headers=bearer(token(signers)))).status_code == 401
        issuer.shutdown()
        # without the issuer, the keys that were read last count
        async with client_of(app) as client:
            assert (await client.get("/v1/verbs", headers=bearer(token(signers, "ec")))).status_code == 200


async def test_a_key_set_that_cannot_be_read_opens_nothing(catalog, signers, tmp_path):
    (tmp_path / "keys.json").write_text('{"keys": [1')
    for source in (tmp_path / "keys.json", tmp_path / "none.json"):
        async with client_of(app_of(catalog, jwt_jwks=str(source))) as client:
            assert (await client.get("/v1/verbs", headers=bearer(token(signers)))).status_code == 401


@pytest.mark.parametrize("encoded", [False, True])
async def test_keys_are_accepted_beside_tokens(tmp_path, encoded):
    settings = Settings(data=tmp_path, jwt_jwks=str(tmp_path / "none.json"))
    store = open_keys(settings.database)
    key = added(store, "pose")
    access = Access(settings, public=False)
    access.load(store)
    text = base64.urlsafe_b64encode(key.encode()).decode().rstrip("=") if encoded else key
    assert (await access.find(text)).scopes == {"pose"}
    store.close()
