"""``adverb doctor``: problems of a machine and a data folder, each with its remedy."""

from __future__ import annotations

import json
import os
import shutil
import socket
import sqlite3
import time

import pytest
from typer.testing import CliRunner

from service.cli.doctor import findings
from service.run.listener import CannotServe, listen
from service.settings import Settings
from service.store.store import Store
from tests.service.access.conftest import added
from tests.service.cli.test_backup import LIBRARY, published
from verbs import cli


@pytest.fixture
def settings(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    return Settings(data=tmp_path, port=port)


@pytest.fixture
def store(settings):
    store = Store.open(settings.database, settings.artifacts)
    published(store, "arm3")
    yield store
    store.close()


def states(settings) -> dict[str, tuple[str, str]]:
    return {row.check: (row.state, row.found) for row in findings(settings)}


def test_a_folder_in_order_has_no_failures(settings, store):
    rows = list(findings(settings))
    assert {row.check for row in rows} >= {
        "Python", "packages", "kernels", "page", "open files", "data folder", "disk", "address", "exposure", "database",
        "artifacts", "time", "keys",
    }  # fmt: skip
    assert not [row for row in rows if row.state == "failed"]
    assert all(row.advice for row in rows if row.state != "ok")


def test_a_new_folder_is_left_alone(settings):
    assert states(settings)["database"] == ("ok", "there is none yet; the first start creates it")
    assert list(settings.data.iterdir()) == []


def test_nothing_is_created(settings, store):
    store.close()
    database = sqlite3.connect(settings.data / "state.db")
    database.execute("DROP TABLE adverb_drafts")
    database.commit()
    shutil.rmtree(settings.artifacts)
    before = sorted(path.name for path in settings.data.iterdir())
    state, found = states(settings)["artifacts"]
    assert state == "failed"
    assert "is missing" in found
    assert sorted(path.name for path in settings.data.iterdir()) == before
    assert database.execute("SELECT name FROM sqlite_master WHERE name = 'adverb_drafts'").fetchone() is None
    database.close()
    other = settings.model_copy(update={"database_url": f"sqlite:///{settings.data}/other.db"})
    assert states(other)["database"] == ("ok", "there is none yet; the first start creates it")
    assert not (settings.data / "other.db").exists()


def test_a_public_address_needs_a_valid_key(settings, store):
    public = settings.model_copy(update={"host": "0.0.0.0"})
    assert states(public)["exposure"] == ("failed", "no key is valid, so a server on 0.0.0.0 does not start")
    key = added(store.keys, "pose")
    assert states(public)["exposure"] == ("ok", "other machines can reach the server, with a key")
    store.keys.revoke(key.split("_")[1])
    assert states(public)["exposure"][0] == "failed"
    with pytest.raises(CannotServe):
        listen(public)
    for allowed in ({"keys": "required"}, {"jwt_jwks": "https://issuer/keys"}):
        assert states(public.model_copy(update=allowed))["exposure"][0] == "ok"


def test_a_public_address_needs_a_key_before_the_first_start(settings):
    public = settings.model_copy(update={"host": "0.0.0.0"})
    assert states(public)["exposure"][0] == "failed"
    assert list(settings.data.iterdir()) == []


def test_a_used_port_is_named(settings):
    with socket.create_server(("127.0.0.1", settings.port)):
        assert states(settings)["address"][0] == "failed"


def test_a_running_server_is_recognised(serve):
    with serve() as server:
        found = states(Settings(data=server.settings.data or "data", port=server.port))
    assert found["address"][0] == "ok"
    assert "answers" in found["address"][1]


@pytest.mark.parametrize("damage", ["missing", "changed"])
def test_a_damaged_artifact_is_named(settings, store, damage):
    path = store.path(store.current()["arm3"])
    if damage == "missing":
        path.unlink()
    else:
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    state, found = states(settings)["artifacts"]
    assert state == "failed"
    assert "arm3 version 1" in found


def test_a_database_that_is_none_is_named(settings):
    (settings.data / "state.db").write_bytes(b"no database" * 100)
    assert states(settings)["database"][0] == "failed"


def test_tables_of_another_layout_are_not_changed(settings, store):
    store.close()
    for layout, state in ((2, "warning"), (99, "failed")):
        database = sqlite3.connect(settings.data / "state.db")
        database.execute("UPDATE adverb_layout SET number = ?", (layout,))
        database.commit()
        assert states(settings)["database"][0] == state
        assert database.execute("SELECT number FROM adverb_layout").fetchone() == (layout,)
        database.close()


def test_a_database_out_of_reach_is_named(settings):
    other = settings.model_copy(update={"database_url": "postgresql://nobody@127.0.0.1:1/none"})
    assert states(other)["database"][0] == "failed"


def test_a_folder_without_write_access_is_named(settings):
    if os.geteuid() == 0:
        pytest.skip("the superuser can write to every folder")
    settings.data.chmod(0o500)
    assert states(settings)["data folder"][0] == "failed"


def test_keys_that_end_are_named(settings, store):
    key = added(store.keys, "pose", expires_at_s=time.time() + 60)
    assert states(settings)["keys"][0] == "warning"
    store.keys.revoke(key.split("_")[1])
    assert states(settings)["keys"] == ("warning", "all keys are revoked or expired")


def test_a_clock_that_was_set_back_is_named(settings, store):
    late = Store.open(settings.database, settings.artifacts, clock=lambda: time.time() + 3_600)
    late.publish("reach", LIBRARY / "reach.verb", author="ada", reason="late", quality={})
    late.close()
    state, found = states(settings)["time"]
    assert state == "warning"
    assert "in the future" in found


def test_the_command_prints_rows_and_fails_on_failures(settings, store, tmp_path):
    run = CliRunner().invoke
    given = ["doctor", "--data", str(tmp_path), "--port", str(settings.port)]
    good = run(cli.app, [*given, "--json"])
    assert good.exit_code == 0, good.stdout
    assert {row["state"] for row in json.loads(good.stdout)} <= {"ok", "warning"}
    assert "data folder" in run(cli.app, given).stdout
    store.path(store.current()["arm3"]).unlink()
    assert run(cli.app, given).exit_code == 1
