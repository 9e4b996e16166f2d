"""Pages of other sites cannot use a server through a browser; everything else can."""

import json

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from service.http.guard import allowed_names
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
