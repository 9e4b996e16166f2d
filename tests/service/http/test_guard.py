"""Pages of other sites cannot use a server through a browser; everything else can."""

import json

import pytest
from pydantic import ValidationError
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from service.http import evaluation
from service.http.guard import allowed_names
from service.settings import Settings
from tests.service.conftest import app_of, client_of


@pytest.fixture(scope="module")
def server(serve):
    with serve() as server:
        yield server


ADVERBS = {"adverbs": {"x": 0.4, "y": 0.2}}
ACTIVATE = "/v1/verbs/arm3/versions/1/activate"


@pytest.mark.anyio
@pytest.mark.parametrize(
    "origin", ["http://evil.example", "https://localhost.evil.example", "http://localhost:81", "null", "http://[", ""]
)
async def test_a_foreign_page_cannot_change_anything(client, origin):
    headers = {"Origin": origin} if origin else {"Sec-Fetch-Site": "cross-site"}
    answer = await client.post(ACTIVATE, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "foreign_origin")
    answer = await client.delete("/v1/verbs/arm3", headers=headers)
    assert answer.status_code == 403


@pytest.mark.anyio
@pytest.mark.parametrize("origin", ["http://localhost", "http://localhost:80", "HTTP://LOCALHOST", "https://localhost"])
async def test_the_own_page_can(client, origin):
    answer = await client.post("/v1/verbs/arm3/pose", json=ADVERBS, headers={"Origin": origin})
    assert answer.status_code == 200
    answer = await client.post(ACTIVATE, headers={"Origin": origin, "Sec-Fetch-Site": "same-origin"})
    assert answer.json()["code"] == "read_only"  # it passed the check: this server has no data folder


@pytest.mark.anyio
async def test_programs_without_an_origin_can(client):
    assert (await client.post("/v1/verbs/arm3/pose", json=ADVERBS)).status_code == 200


@pytest.mark.anyio
async def test_reading_does_not_depend_on_the_origin(client):
    assert (await client.get("/v1/verbs", headers={"Origin": "http://evil.example"})).status_code == 200


@pytest.mark.anyio
@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8000", "localhost.evil.example", "a b", "[", "127.1.evil"]
)
async def test_an_unknown_host_is_refused(client, host):
    for path in ("/v1/verbs", "/", "/metrics"):
        answer = await client.get(path, headers={"Host": host})
        assert (answer.status_code, answer.json()["code"]) == (421, "unknown_host")
    assert "ADVERB_ALLOWED_HOSTS" in answer.json()["detail"]


@pytest.mark.anyio
@pytest.mark.parametrize(
    "host", ["localhost:8000", "LOCALHOST.", "127.0.0.1", "[::1]:8000", "192.168.1.7:80", "10.0.0.1"]
)
async def test_addresses_and_localhost_are_known(client, host):
    assert (await client.get("/v1/verbs", headers={"Host": host})).status_code == 200


@pytest.mark.anyio
async def test_a_setting_adds_names(catalog):
    async with client_of(app_of(catalog, allowed_hosts="Game.Example, other.example")) as client:
        assert (await client.get("/v1/verbs", headers={"Host": "game.example:443"})).status_code == 200
        assert (await client.get("/v1/verbs", headers={"Host": "third.example"})).status_code == 421
        headers = {"Host": "game.example", "Origin": "https://game.example"}
        assert (await client.post("/v1/verbs/arm3/pose", json=ADVERBS, headers=headers)).status_code == 200
    async with client_of(app_of(catalog, allowed_hosts="*")) as client:
        assert (await client.get("/v1/verbs", headers={"Host": "any.example"})).status_code == 200


GAME, OTHER = "https://game.example", "http://localhost:5173"


@pytest.mark.anyio
async def test_pages_of_listed_origins_may_read_and_change(catalog):
    async with client_of(app_of(catalog, cors_origins=f"{GAME}, {OTHER.upper()}/")) as client:
        for origin in (GAME, OTHER):
            for answer in (
                await client.get("/v1/verbs/arm3", headers={"Origin": origin}),
                await client.post("/v1/verbs/arm3/pose", json=ADVERBS, headers={"Origin": origin}),
            ):
                assert answer.status_code == 200
                assert answer.headers["access-control-allow-origin"] == origin
                assert "Origin" in answer.headers["vary"]
                assert "etag" in answer.headers["access-control-expose-headers"].lower()
            answer = await client.post(ACTIVATE, headers={"Origin": origin, "Sec-Fetch-Site": "cross-site"})
            assert answer.json()["code"] == "read_only"
        preflight = {"Origin": GAME, "Access-Control-Request-Method": "POST",
                     "Access-Control-Request-Headers": "authorization,content-type,if-match"}  # fmt: skip
        answer = await client.options("/v1/verbs/arm3/pose", headers=preflight)
        assert answer.status_code == 200
        assert answer.headers["access-control-allow-origin"] == GAME
        assert "access-control-allow-credentials" not in answer.headers


@pytest.mark.anyio
async def test_pages_of_listed_origins_may_read_every_answer(catalog, monkeypatch):
    def fails(*_, **__):
        raise RuntimeError("a fault of the server")

    monkeypatch.setattr(evaluation, "pose", fails)
    async with client_of(app_of(catalog, cors_origins=GAME, rate_per_address="2/hour")) as client:
        answers = [
            await client.post("/v1/verbs/arm3/pose", json=ADVERBS, headers={"Origin": GAME, **more})
            for more in ({}, {"Host": "stranger.example"}, {})
        ]
    assert [answer.status_code for answer in answers] == [500, 421, 429]
    for answer in answers:
        assert answer.headers["access-control-allow-origin"] == GAME
        assert answer.headers["x-request-id"]


@pytest.mark.anyio
async def test_pages_of_other_origins_may_not(catalog):
    async with client_of(app_of(catalog, cors_origins=GAME)) as client:
        for origin in ("https://game.example.evil.example", "http://game.example", "https://game.example:444", "null"):
            answer = await client.get("/v1/verbs/arm3", headers={"Origin": origin})
            assert "access-control-allow-origin" not in answer.headers
            answer = await client.post("/v1/verbs/arm3/pose", json=ADVERBS, headers={"Origin": origin})
            assert (answer.status_code, answer.json()["code"]) == (403, "foreign_origin")
            preflight = {"Origin": origin, "Access-Control-Request-Method": "POST"}
            assert (await client.options("/v1/verbs/arm3/pose", headers=preflight)).status_code == 400


@pytest.mark.anyio
async def test_any_page_where_the_setting_allows_it(catalog):
    async with client_of(app_of(catalog, cors_origins="*")) as client:
        answer = await client.post("/v1/verbs/arm3/pose", json=ADVERBS, headers={"Origin": "http://any.example"})
        assert (answer.status_code, answer.headers["access-control-allow-origin"]) == (200, "*")


@pytest.mark.anyio
async def test_every_answer_has_the_usual_headers(client):
    for path in ("/v1/verbs", "/v1/verbs/nothing", "/livez", "/docs", "/"):
        answer = await client.get(path)
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"


@pytest.mark.anyio
async def test_frames_are_for_the_own_page_and_listed_ones(catalog):
    for listed, expected in (("", "frame-ancestors 'self'"), (GAME, f"frame-ancestors 'self' {GAME}")):
        async with client_of(app_of(catalog, frame_ancestors=listed)) as client:
            for path in ("/", "/docs"):
                policy = (await client.get(path)).headers["content-security-policy"]
                assert policy.split("; ")[-1] == expected


@pytest.mark.parametrize(
    "listed", ["game.example", "ftp://game.example", "https://", "https://a.example/path", "https://user@a.example"]
)
def test_what_is_no_origin_is_named(listed):
    for name in ("cors_origins", "frame_ancestors"):
        with pytest.raises(ValidationError, match="is not an origin"):
            Settings(**{name: f"{GAME}, {listed}"})


def test_the_address_that_is_listened_on_is_a_known_name():
    assert {"localhost", "dance.example"} <= allowed_names("dance.example", "")


@pytest.mark.anyio
async def test_streams_of_foreign_pages_are_refused(server):
    for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}):
        with pytest.raises(InvalidStatus) as refused:
            async with connect(server.url, additional_headers=headers):
                pass
        body = json.loads(refused.value.response.body)
        assert body["code"] in ("foreign_origin", "unknown_host")
        assert refused.value.response.status_code == body["status"]


@pytest.mark.anyio
async def test_streams_of_the_own_page_and_of_programs_are_accepted(server):
    for headers in ({}, {"Origin": f"http://127.0.0.1:{server.port}"}):
        async with connect(server.url, additional_headers=headers, subprotocols=["adverb.v1"]) as socket:
            assert json.loads(await socket.recv())["op"] == "hello"


@pytest.mark.anyio
async def test_streams_of_listed_origins_are_accepted(serve):
    with serve(cors_origins=GAME) as server:
        async with connect(server.url, additional_headers={"Origin": GAME}, subprotocols=["adverb.v1"]) as socket:
            assert json.loads(await socket.recv())["op"] == "hello"
        with pytest.raises(InvalidStatus):
            async with connect(server.url, additional_headers={"Origin": OTHER}):
                pass


@pytest.mark.anyio
@pytest.mark.parametrize("port", ["\xb2", "9" * 5_000])
async def test_a_port_that_is_no_number_is_not_an_error_of_the_server(client, port):
    host = f"localhost:{port}".encode("latin-1")
    assert (await client.get("/v1/verbs", headers={b"Host": host})).status_code == 200
    answer = await client.post(ACTIVATE, headers={b"Host": host, b"Origin": b"http://" + host})
    assert answer.status_code in (403, 409)
