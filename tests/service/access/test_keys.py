"""Keys over time: made, revoked, expired; when they are required; who changed what; what is logged."""

from __future__ import annotations

import asyncio
import io
import json
import logging
import time
from contextlib import contextmanager

import pytest
import structlog
from typer.testing import CliRunner
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from service.access.keys import FORM, hash_of, id_of, matches, new
from service.app import create_app
from service.cli.keys import app as commands
from service.http import evaluation
from service.run import logs
from service.run.listener import CannotServe, listen
from service.settings import Settings
from service.store.keys import open_keys
from service.store.records import Key, UnknownKey
from tests.service.access.conftest import added, bearer
from tests.service.catalog.conftest import PATIENCE_S, ZIP, Kept, client_of, zipped_arm
from tests.service.conftest import app_of
from tests.service.conftest import client_of as client_of_app

SECOND = 1.0


async def until_status(client, path, status, **options):
    """Seconds until a request is answered with a status."""
    started = time.monotonic()
    while (await client.get(path, **options)).status_code != status:
        assert time.monotonic() - started < PATIENCE_S
        await asyncio.sleep(0.02)
    return time.monotonic() - started


async def close_code(stream):
    """Code with which the server closes a stream."""
    try:
        async with asyncio.timeout(PATIENCE_S):
            while True:
                await stream.recv()
    except ConnectionClosed as err:
        return err.rcvd.code


def test_keys_are_long_and_differ():
    made = [new() for _ in range(100)]
    assert len({text for _, text in made}) == len({id for id, _ in made}) == 100
    for id, text in made:
        assert FORM.fullmatch(text)
        assert id_of(text) == id
        key = Key(id, "", frozenset(), hash_of(text), 0.0)
        assert matches(text, key)
        assert not matches(text[:-1] + ("A" if text[-1] != "A" else "B"), key)


def test_the_store_has_no_key(tmp_path):
    store = open_keys(f"sqlite:///{tmp_path / 'state.db'}")
    secret = added(store, "pose").split("_", 2)[2]
    store.close()
    content = b"".join(path.read_bytes() for path in tmp_path.iterdir())
    assert content
    assert secret.encode() not in content


def test_revoking_is_final_and_names_unknown_ids(tmp_path):
    store = open_keys(f"sqlite:///{tmp_path / 'state.db'}")
    id = added(store, "pose").split("_")[1]
    first = store.revoke(id).revoked_at_s
    assert store.revoke(id).revoked_at_s == first
    with pytest.raises(UnknownKey):
        store.revoke("0" * 16)
    store.close()


@pytest.mark.anyio
async def test_a_revoked_key_is_refused_within_a_second_and_its_streams_end(guarded):
    key = added(guarded.store, "pose")
    async with client_of(guarded.server) as client:
        assert (await client.get("/v1/verbs", headers=bearer(key))).status_code == 200  # at once
        async with connect(guarded.server.url, additional_headers=bearer(key)) as stream:
            guarded.store.revoke(key.split("_")[1])
            assert await until_status(client, "/v1/verbs", 401, headers=bearer(key)) < SECOND
            assert await close_code(stream) == 4401
        other = await client.get("/v1/verbs", headers=bearer(guarded.keys["pose"]))
        assert other.status_code == 200


@pytest.mark.anyio
async def test_streams_of_an_expired_key_end(guarded):
    key = added(guarded.store, "pose", expires_at_s=time.time() + 1.0)
    async with connect(guarded.server.url, additional_headers=bearer(key)) as stream:
        assert await close_code(stream) == 4401


@pytest.mark.anyio
async def test_the_first_key_closes_an_open_server_for_good(tmp_path):
    server = Kept(data=tmp_path, refiners=0).start(PATIENCE_S)
    store = open_keys(server.settings.database)
    try:
        async with client_of(server) as client, connect(server.url) as stream:
            assert (await client.get("/v1/verbs")).status_code == 200
            key = added(store, "pose")
            assert await until_status(client, "/v1/verbs", 401) < SECOND
            assert await close_code(stream) == 4401
            store.revoke(key.split("_")[1])
            await until_status(client, "/v1/verbs", 401, headers=bearer(key))
            assert (await client.get("/v1/verbs")).status_code == 401  # no valid key is left, and it stays closed
    finally:
        store.close()
        server.stop()


@contextmanager
def logged(**settings):
    """What is logged in the format of the settings, by all but the clients of this test."""
    output = io.StringIO()
    root = logging.getLogger()
    before = root.level, list(root.handlers), structlog.get_config()["processors"]
    try:
        logs.configure(Settings(**settings))
        handler = logging.StreamHandler(output)
        handler.setFormatter(root.handlers[0].formatter)
        handler.addFilter(lambda record: not record.name.startswith(("websockets.client", "httpx", "httpcore")))
        root.handlers[:] = [handler]
        yield output
    finally:
        root.setLevel(before[0])
        root.handlers[:] = before[1]
        structlog.configure(processors=before[2])


@pytest.mark.anyio
@pytest.mark.parametrize("log_json", [False, True], ids=["text", "json"])
async def test_a_key_is_never_logged(tmp_path, capfd, monkeypatch, log_json):
    store = open_keys(f"sqlite:///{tmp_path / 'state.db'}")
    key = added(store, "pose")

    def fails(*_, **__):
        raise RuntimeError("a fault of the server")

    monkeypatch.setattr(evaluation, "pose", fails)
    with logged(log_level="debug", log_json=log_json) as output:
        server = Kept(data=tmp_path, refiners=0).start(PATIENCE_S)
        async with client_of(server) as client:
            assert (await client.get("/v1/verbs", headers=bearer(key))).status_code == 200
            assert (await client.get("/v1/audit", headers=bearer(key))).status_code == 403
            body = {"adverbs": {"x": 0.125875}}
            answer = await client.post("/v1/verbs/arm3/pose", headers=bearer(key), json=body)
            assert answer.status_code == 500
        async with connect(server.url, subprotocols=["adverb.v1", f"adverb.bearer.{key}"]) as stream:
            await stream.send("no JSON")
            await stream.recv()
        server.stop()
    store.close()
    found = output.getvalue() + "".join(capfd.readouterr())
    assert "a fault of the server" in found
    assert key.split("_", 2)[2] not in found
    assert "0.125875" not in found


@pytest.mark.parametrize("log_json", [False, True], ids=["text", "json"])
def test_control_characters_are_escaped(log_json):
    hostile = "\x1b]0;title\x07\x9b2J\rforged\n2026-01-01 [info] forged"
    with logged(log_json=log_json) as output:
        try:
            raise ValueError(hostile)
        except ValueError:
            structlog.get_logger("adverb").exception(f"failed {hostile}", path=hostile.replace(" ", "_"))
        logging.getLogger("uvicorn.error").error("of a library: %s", hostile)
    assert output.getvalue().count("forged") >= 6
    assert not {"\x1b", "\x07", "\x9b", "\r"} & set(output.getvalue())
    assert "\n2026-01-01_[info]_forged" not in output.getvalue()


@pytest.mark.anyio
async def test_changes_are_recorded_with_their_key(guarded, tmp_path):
    keys = guarded.keys
    async with client_of(guarded.server) as client:
        content = zipped_arm(tmp_path / "arm")
        headers = bearer(keys["author"]) | {"Content-Type": ZIP}
        made = (await client.post("/v1/verbs", content=content, headers=headers)).json()
        verb, number = made["verb"], made["version"]
        job = await client.post(f"/v1/verbs/{verb}/refinements", json={}, headers=bearer(keys["refine"]))
        assert job.status_code == 202, job.text
        await client.delete(f"/v1/refinements/{job.json()['id']}", headers=bearer(keys["refine"]))
        await client.delete(f"/v1/verbs/{verb}", headers=bearer(keys["author"]))
        await client.post(f"/v1/verbs/{verb}/versions/{number}/activate", headers=bearer(keys["admin"]))
        listed = (
            await client.get("/v1/audit", params={"verb": verb, "limit": 5}, headers=bearer(keys["admin"]))
        ).json()
        changes = listed["changes"]
        older = await client.get(
            "/v1/audit", params={"verb": verb, "before": changes[1]["id"], "limit": 1}, headers=bearer(keys["admin"])
        )
    labels = {scope: f"key {keys[scope].split('_')[1]} (of {scope})" for scope in ("author", "refine", "admin")}
    assert [(row["kind"], row["author"]) for row in changes] == [
        ("activate", labels["admin"]),
        ("delete", labels["author"]),
        ("cancel", labels["refine"]),
        ("refine", labels["refine"]),
        ("publish", labels["author"]),
    ]
    assert made["author"] == labels["author"]
    assert older.json()["changes"] == changes[2:3]


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("settings", "status"),
    [
        ({}, 200),
        ({"keys": "required"}, 401),
        ({"host": "0.0.0.0"}, 401),
        ({"host": "0.0.0.0", "allow_public": True}, 200),
        ({"host": "0.0.0.0", "keys": "off"}, 200),
        ({"host": "0.0.0.0", "keys": "required", "allow_public": True}, 401),
        ({"jwt_jwks": "nothing.json"}, 401),
    ],
)
async def test_when_a_key_is_required(catalog, settings, status):
    async with client_of_app(app_of(catalog, **settings)) as client:
        assert (await client.get("/v1/verbs", headers={"Host": "localhost"})).status_code == status
        assert (await client.get("/livez")).status_code == 200


@pytest.mark.anyio
async def test_metrics_and_docs_have_their_own_switches(catalog):
    async with client_of_app(app_of(catalog, keys="required", open_metrics=True)) as client:
        statuses = [
            (await client.get(path)).status_code for path in ("/metrics", "/docs", "/openapi.json", "/v1/verbs")
        ]
        assert statuses == [200, 401, 401, 401]
    async with client_of_app(app_of(catalog, keys="required", open_docs=True)) as client:
        statuses = [
            (await client.get(path)).status_code for path in ("/metrics", "/docs", "/openapi.json", "/v1/verbs")
        ]
        assert statuses == [401, 200, 200, 401]


@pytest.mark.anyio
async def test_nothing_is_served_before_the_keys_are_known(tmp_path):
    async with client_of_app(create_app(Settings(data=tmp_path))) as client:
        answer = await client.get("/v1/verbs")
        assert (answer.status_code, answer.json()["code"]) == (503, "not_ready")
        assert (await client.get("/livez")).status_code == 200


def test_a_public_address_needs_a_valid_key(tmp_path):
    settings = Settings(host="0.0.0.0", port=0, data=tmp_path)
    with pytest.raises(CannotServe, match="keys create"):
        listen(settings)
    store = open_keys(settings.database)
    key = added(store, "pose")
    with listen(settings):
        pass
    store.revoke(key.split("_")[1])
    store.close()
    with pytest.raises(CannotServe):
        listen(settings)


def test_a_public_address_without_a_database_that_answers_is_served(tmp_path):
    settings = Settings(host="0.0.0.0", port=0, data=tmp_path, database_url="postgresql://nobody@127.0.0.1:1/none")
    with listen(settings):
        pass  # every request needs a key until the keys can be read


def test_the_commands(tmp_path):
    run = CliRunner().invoke
    options = ["--name", "game", "--expires", "30d", "--json", "--data", str(tmp_path)]
    made = run(commands, ["create", "--scope", "pose", "--scope", "refine", *options])
    assert made.exit_code == 0, made.stderr
    found = json.loads(made.stdout)
    assert set(found) == {"id", "key"}
    assert id_of(found["key"]) == found["id"]
    plain = run(commands, ["create", "--scope", "admin", "--data", str(tmp_path)])
    assert id_of(plain.stdout.strip())
    assert "never expires" in plain.stderr
    rows = json.loads(run(commands, ["list", "--json", "--data", str(tmp_path)]).stdout)
    assert (rows[0]["id"], rows[0]["scopes"], rows[0]["state"]) == (found["id"], ["pose", "refine"], "valid")
    assert rows[0]["expires_at"] - rows[0]["created_at"] == pytest.approx(30 * 86_400, abs=1)
    assert run(commands, ["revoke", found["id"], "--data", str(tmp_path)]).exit_code == 0
    table = run(commands, ["list", "--data", str(tmp_path)]).stdout
    assert "revoked" in table
    assert found["key"] not in table


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["create", "--scope", "all"], "unknown scope 'all'; known: pose, author, refine, admin"),
        (["create", "--scope", "pose", "--expires", "soon"], "--expires is 'soon'"),
        (["create", "--scope", "pose", "--expires", "2020-01-01"], "is past"),
        (["create", "--scope", "pose", "--expires", "0d"], "is past"),
        (["create", "--scope", "pose", "--name", "x" * 101], "at most 100"),
        (["revoke", "0123"], "unknown key '0123'"),
    ],
)
def test_mistakes_are_named(tmp_path, arguments, message):
    answer = CliRunner().invoke(commands, [*arguments, "--data", str(tmp_path)])
    assert answer.exit_code == 1
    assert message in answer.stderr


def test_a_missing_folder_is_named(tmp_path):
    answer = CliRunner().invoke(commands, ["list", "--data", str(tmp_path / "no")])
    assert answer.exit_code == 1
    assert "does not exist" in answer.stderr
