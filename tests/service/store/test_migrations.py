from __future__ import annotations

import json
from hashlib import sha256

import pytest
from sqlalchemy import create_engine, inspect, make_url, text, update

from service.store import migrations, tables
from service.store.store import Event, Job, StoreError, Version

LAYOUT_1 = """
CREATE TABLE adverb_layout (number INTEGER NOT NULL, PRIMARY KEY (number));
CREATE TABLE adverb_verbs (name VARCHAR(63) NOT NULL, last INTEGER NOT NULL, PRIMARY KEY (name));
CREATE TABLE adverb_versions (
    verb VARCHAR(63) NOT NULL, number INTEGER NOT NULL, sha256 VARCHAR(64) NOT NULL, size_bytes BIGINT NOT NULL,
    who TEXT NOT NULL, why TEXT NOT NULL, quality TEXT NOT NULL, created_at_s DOUBLE PRECISION NOT NULL, parent INTEGER,
    PRIMARY KEY (verb, number), FOREIGN KEY(verb) REFERENCES adverb_verbs (name));
CREATE INDEX ix_adverb_versions_sha256 ON adverb_versions (sha256);
CREATE TABLE adverb_pointers (
    verb VARCHAR(63) NOT NULL, number INTEGER NOT NULL, PRIMARY KEY (verb),
    FOREIGN KEY(verb, number) REFERENCES adverb_versions (verb, number));
CREATE TABLE adverb_events (
    id {serial} NOT NULL, verb VARCHAR(63) NOT NULL, kind VARCHAR(16) NOT NULL, number INTEGER NOT NULL,
    current INTEGER, who TEXT NOT NULL, why TEXT NOT NULL, at_s DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (id), FOREIGN KEY(verb) REFERENCES adverb_verbs (name));
CREATE INDEX adverb_events_of_verb ON adverb_events (verb, id);
CREATE TABLE adverb_jobs (
    id VARCHAR(200) NOT NULL, verb VARCHAR(63) NOT NULL, state VARCHAR(16) NOT NULL, asked TEXT NOT NULL,
    progress TEXT NOT NULL, reaps INTEGER NOT NULL, version_before INTEGER, version_after INTEGER, detail TEXT NOT NULL,
    created_at_s DOUBLE PRECISION NOT NULL, updated_at_s DOUBLE PRECISION NOT NULL, PRIMARY KEY (id));
CREATE INDEX ix_adverb_jobs_verb ON adverb_jobs (verb);
CREATE INDEX ix_adverb_jobs_created_at_s ON adverb_jobs (created_at_s);
CREATE TABLE adverb_traffic (
    verb VARCHAR(63) NOT NULL, server VARCHAR(200) NOT NULL, cells TEXT NOT NULL, at_s DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (verb, server));
INSERT INTO adverb_layout VALUES (1);
INSERT INTO adverb_verbs VALUES ('reach', 1);
INSERT INTO adverb_versions VALUES ('reach', 1, '{digest}', 5, 'ada', 'first', '{{"error_mean_m":0.5}}', 7.0, NULL);
INSERT INTO adverb_pointers VALUES ('reach', 1);
INSERT INTO adverb_events (verb, kind, number, current, who, why, at_s)
    VALUES ('reach', 'publish', 1, 1, 'ada', 'first', 7.0);
INSERT INTO adverb_jobs VALUES ('j1', 'reach', 'not_better', '{{"max_pseudo":9,"who":"bob"}}', '{{"ratio":1.0}}', 0, 1,
    NULL, 'said', 8.0, 9.0);
INSERT INTO adverb_traffic VALUES ('reach', 'host-1', '{{"cells":[]}}', 8.0)
"""
"""The tables and one row of each, as layout 1 wrote them."""

DIGEST = sha256(b"bytes").hexdigest()


@pytest.fixture
def old(location):
    """A store with layout 1."""
    engine = create_engine(make_url(location.database).set(drivername=_driver(location)))
    serial = "INTEGER" if _is_sqlite(location) else "BIGSERIAL"
    with engine.begin() as connection:
        for statement in LAYOUT_1.format(serial=serial, digest=DIGEST).split(";"):
            connection.exec_driver_sql(statement)
    engine.dispose()
    location.artifacts.mkdir(exist_ok=True)
    (location.artifacts / f"{DIGEST}.verb").write_bytes(b"bytes")
    return location


def test_a_database_of_layout_1_is_upgraded_and_keeps_its_rows(old, artifact):
    store = old.open()
    try:
        version = Version("reach", 1, DIGEST, 5, "ada", "first", {"error_mean_m": 0.5}, 7.0, None)
        assert store.current() == {"reach": version}
        assert store.path(version).read_bytes() == b"bytes"
        assert store.history("reach") == [Event("reach", "publish", 1, 1, "ada", "first", 7.0)]
        request = {"max_pseudo": 9, "author": "bob"}
        assert store.jobs() == [Job("j1", "reach", "not_better", request, {"ratio": 1.0}, 0, 1, None, "said", 8.0, 9.0)]
        assert store.usage("reach", not_before_s=0.0) == [{"cells": []}]
        assert store.publish("reach", artifact("two"), author="eve", reason="second", quality={}).number == 2
    finally:
        store.close()


def test_an_upgraded_database_has_the_columns_of_a_new_one(old):
    old.open().close()
    old.open().close()  # nothing is left to upgrade
    engine = create_engine(make_url(old.database).set(drivername=_driver(old)))
    for table in tables.metadata.sorted_tables:
        assert [row["name"] for row in inspect(engine).get_columns(table.name)] == list(table.columns.keys())
    with engine.connect() as connection:
        assert connection.execute(text("SELECT number FROM adverb_layout")).scalars().all() == [migrations.LAYOUT]
    engine.dispose()


def test_an_upgrade_that_fails_leaves_layout_1(old, monkeypatch):
    def fail(text: str) -> None:
        raise ValueError("not JSON")

    monkeypatch.setattr(json, "loads", fail)
    with pytest.raises(ValueError, match="not JSON"):
        old.open()
    monkeypatch.undo()
    store = old.open()
    try:
        assert store.current()["reach"].author == "ada"
        assert store.job("j1").request["author"] == "bob"
    finally:
        store.close()


def test_tables_of_a_newer_layout_are_refused(store, location):
    with store._database.transaction(writes=True) as connection:
        connection.execute(update(tables.layouts).values(number=migrations.LAYOUT + 1))
    with pytest.raises(StoreError, match="upgrade it"):
        location.open()


def _is_sqlite(location) -> bool:
    return location.database.startswith("sqlite")


def _driver(location) -> str:
    return "sqlite" if _is_sqlite(location) else "postgresql+psycopg"
