from __future__ import annotations

import sqlite3
import time
from contextlib import ExitStack, closing, contextmanager

import psycopg
import pytest

from service.cli.doctor import findings
from service.settings import Settings
from service.store.store import BadAddress, Store, StoreUnavailable
from service.store.tables import CONNECTIONS
from tools.postgres import OTHERS

BY_ADA = {"author": "ada", "reason": "a test", "quality": {}}


@contextmanager
def held(database: str):
    """Another connection holds a lock that every writer needs."""
    if database.startswith("sqlite"):
        with closing(sqlite3.connect(database.removeprefix("sqlite:///"), isolation_level=None)) as connection:
            connection.execute("BEGIN EXCLUSIVE")
            yield
            connection.execute("ROLLBACK")
        return
    with psycopg.connect(database) as connection:
        connection.execute("LOCK TABLE adverb_verbs IN ACCESS EXCLUSIVE MODE")
        yield
        connection.rollback()


def test_waiting_for_a_lock_times_out(location, artifact):
    store = location.open(timeout_s=0.5)
    store.publish("reach", artifact("one"), **BY_ADA)
    with held(location.database):
        began = time.monotonic()
        with pytest.raises(StoreUnavailable) as caught:
            store.publish("reach", artifact("two"), **BY_ADA)
        assert 0.3 < time.monotonic() - began < 4.0
        assert not store.available
        assert "lock" in caught.value.reason
        assert len(caught.value.reason) <= 200
    assert store.publish("reach", artifact("two"), **BY_ADA).number == 2
    assert store.available
    store.close()


def test_waiting_for_a_connection_is_no_outage(location):
    store = location.open(timeout_s=0.2)
    with ExitStack() as used:
        for _ in range(CONNECTIONS):
            used.enter_context(store._database.transaction())
        with pytest.raises(StoreUnavailable, match="no connection became free within 0.2 s"):
            store.current()
        assert store.available
        assert store.keys.listed() == []  # keys have a connection of their own
    assert store.current() == {}
    store.close()
    with pytest.raises(StoreUnavailable, match="closed"):
        store.keys.listed()


def test_a_postgresql_that_stops_and_comes_back(postgres, tmp_path, artifact):
    store = Store.open(postgres.database(), str(tmp_path / "artifacts"))
    version = store.publish("reach", artifact("one"), **BY_ADA)
    postgres.stop()
    try:
        for call in (
            store.current,
            lambda: store.publish("reach", artifact("two"), **BY_ADA),
            lambda: store.collect(now_s=0.0),
            lambda: store.job("x"),
        ):
            began = time.monotonic()
            with pytest.raises(StoreUnavailable):
                call()
            assert time.monotonic() - began < 5.0
            assert not store.available
        with pytest.raises(StoreUnavailable):
            Store.open(postgres.address("postgres"), str(tmp_path / "artifacts"))
        assert store.path(version).exists()  # artifacts do not need the database
    finally:
        postgres.start()
    assert store.current() == {"reach": version}
    assert store.available
    assert store.publish("reach", artifact("two"), **BY_ADA).number == 2
    store.close()


def test_waiting_for_a_frozen_postgresql_times_out(postgres, folder, artifact):
    store = Store.open(postgres.database(), str(folder), timeout_s=0.5)
    store.publish("reach", artifact("one"), **BY_ADA)
    with postgres.frozen():
        began = time.monotonic()
        with pytest.raises(StoreUnavailable, match="timeout|does not answer"):
            store.current()
        assert time.monotonic() - began < 5.0
        assert not store.available
    assert store.current()["reach"].number == 1
    assert store.publish("reach", artifact("two"), **BY_ADA).number == 2
    store.close()


def test_waiting_for_a_server_that_freezes_in_a_transaction_times_out(postgres, folder, artifact):
    store = Store.open(postgres.database(), str(folder), timeout_s=0.5)
    frozen = postgres.frozen()

    with pytest.raises(StoreUnavailable, match="does not answer within 0.5 s"):
        store.publish("reach", artifact("one"), **BY_ADA, at=lambda step: step == "commit" and frozen.__enter__())
    frozen.__exit__(None, None, None)
    assert store.publish("reach", artifact("one"), **BY_ADA).number == 1
    assert len(store.versions("reach")) == 1  # whether the first was committed or not
    store.close()


def test_a_connection_that_dies_while_it_is_used(postgres, tmp_path, artifact):
    address = postgres.database()
    store = Store.open(address, str(tmp_path / "artifacts"))

    def cut(step: str) -> None:
        if step == "commit":
            with psycopg.connect(address, autocommit=True) as other:
                other.execute(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE {OTHERS}")

    with pytest.raises(StoreUnavailable):
        store.publish("reach", artifact("one"), **BY_ADA, at=cut)
    assert store.current() == {}
    assert store.publish("reach", artifact("one"), **BY_ADA).number == 1
    store.close()


def test_reasons_contain_no_password(postgres, tmp_path):
    address = f"postgresql://adverb:hunter2@/none?host={postgres.folder}"
    with pytest.raises(StoreUnavailable, match='database "none" does not exist') as caught:
        Store.open(address, str(tmp_path))
    assert "hunter2" not in str(caught.value)


def test_an_invalid_database_file_is_refused(tmp_path):
    (tmp_path / "state.db").write_bytes(b"not a database" * 1000)
    with pytest.raises(StoreUnavailable, match="file is not a database"):
        Store.open(f"sqlite:///{tmp_path}/state.db", str(tmp_path / "artifacts"))


def test_a_folder_that_cannot_be_created_is_reported(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StoreUnavailable, match="folder cannot be created: Not a directory"):
        Store.open(f"sqlite:///{tmp_path}/state.db", str(tmp_path / "file" / "artifacts"))


def test_a_closed_store_is_unavailable(store):
    store.close()
    with pytest.raises(StoreUnavailable, match="closed"):
        store.current()


@pytest.mark.parametrize("encoding", ["SQL_ASCII", "LATIN1"])
def test_a_postgresql_database_of_another_encoding_is_refused(postgres, tmp_path, encoding):
    address = postgres.address(encoding.lower())
    with psycopg.connect(postgres.address("postgres"), autocommit=True) as connection:
        connection.execute(f"DROP DATABASE IF EXISTS {encoding}")
        connection.execute(f"CREATE DATABASE {encoding} ENCODING '{encoding}' TEMPLATE template0")
    for _ in range(2):
        with pytest.raises(BadAddress, match=f"'{encoding.lower()}' has the encoding {encoding}.*ENCODING 'UTF8'"):
            Store.open(address, str(tmp_path / "artifacts"))
    rows = {row.check: row for row in findings(Settings(data=tmp_path, port=0, database_url=address))}
    assert rows["database"].state == "failed"
    assert "ENCODING 'UTF8'" in rows["database"].found
    with psycopg.connect(address) as connection:
        assert connection.execute("SELECT count(*) FROM pg_tables WHERE schemaname = 'public'").fetchone() == (0,)
