"""A data folder of each earlier layout of the tables, with artifacts of each released format, is opened and served."""

import hashlib
import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from service.store.migrations import LAYOUT
from tests.service.catalog.conftest import PATIENCE_S, Kept, client_of
from tests.service.store.test_migrations import LAYOUT_1

pytestmark = [pytest.mark.anyio]

GOLDEN = Path(__file__).parents[2] / "golden"
FILES = {"arm": "arm.v1", "figure": "contacts.v1", "jump": "jump.v2"}
LAYOUTS = {
    1: (),
    2: (("who TEXT NOT NULL, why TEXT", "author TEXT NOT NULL, reason TEXT"), ("asked TEXT", "request TEXT")),
    3: (("parent INTEGER,", "parent INTEGER, source_sha256 VARCHAR(64),"),),
    4: (),
}
"""How the statements of each layout differ from those of the one before; layouts 3 and 4 also have new tables."""

DRAFTS = """
CREATE TABLE adverb_drafts (
    id VARCHAR(32) NOT NULL, revision INTEGER NOT NULL, name VARCHAR(63) NOT NULL, clips INTEGER NOT NULL,
    excluded INTEGER NOT NULL, archive VARCHAR(64) NOT NULL, motion VARCHAR(64) NOT NULL, artifact VARCHAR(64),
    size_bytes BIGINT NOT NULL, document TEXT NOT NULL, created_at_s DOUBLE NOT NULL, changed_at_s DOUBLE NOT NULL,
    PRIMARY KEY (id));
CREATE INDEX ix_adverb_drafts_changed_at_s ON adverb_drafts (changed_at_s)
"""
KEYS = """
CREATE TABLE adverb_keys (
    id VARCHAR(16) NOT NULL, name TEXT NOT NULL, scopes TEXT NOT NULL, sha256 VARCHAR(64) NOT NULL,
    created_at_s DOUBLE NOT NULL, expires_at_s DOUBLE, revoked_at_s DOUBLE, revision INTEGER NOT NULL,
    PRIMARY KEY (id));
CREATE INDEX ix_adverb_keys_revision ON adverb_keys (revision)
"""


def statements(layout):
    """The statements that made the tables of a layout."""
    text = LAYOUT_1.split("INSERT INTO")[0].format(serial="INTEGER", digest="")
    for number in range(1, layout + 1):
        for old, new in LAYOUTS[number]:
            assert old in text
            text = text.replace(old, new)
    return text + DRAFTS * (layout >= 3) + ";" * (layout >= 4) + KEYS * (layout >= 4)


def folder_of(layout, data):
    """A data folder as the release with a layout left it: three verbs, their events, and a job."""
    (data / "artifacts").mkdir(parents=True)
    with closing(sqlite3.connect(data / "state.db")) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.executescript(statements(layout))
        database.execute("INSERT INTO adverb_layout VALUES (?)", (layout,))
        for verb, name in FILES.items():
            content = (GOLDEN / f"{name}.verb").read_bytes()
            sha256 = hashlib.sha256(content).hexdigest()
            shutil.copy(GOLDEN / f"{name}.verb", data / "artifacts" / f"{sha256}.verb")
            row = (verb, 1, sha256, len(content), "ada", "first", "{}", 7.0, None, None)[: 9 + (layout >= 3)]
            database.execute("INSERT INTO adverb_verbs VALUES (?, 1)", (verb,))
            database.execute(f"INSERT INTO adverb_versions VALUES ({', '.join('?' * len(row))})", row)
            database.execute("INSERT INTO adverb_pointers VALUES (?, 1)", (verb,))
            event = (verb, "publish", 1, 1, "ada", "first", 7.0)
            database.execute("INSERT INTO adverb_events VALUES (NULL, ?, ?, ?, ?, ?, ?, ?)", event)
        request = json.dumps({"max_pseudo": 9, "who" if layout == 1 else "author": "bob"})
        job = ("j1", "arm", "not_better", request, '{"ratio":1.0}', 0, 1, None, "no better", 8.0, 9.0)
        database.execute(f"INSERT INTO adverb_jobs VALUES ({', '.join('?' * len(job))})", job)
        database.commit()
    return data


async def posed(client, verb, golden, body):
    """The served pose of a verb is the one that its file is known for."""
    answer = await client.post(f"/v1/verbs/{verb}/pose", json={**body, "version": 1, "space": "local"})
    assert answer.status_code == 200, answer.text
    expected = json.loads((GOLDEN / golden).read_text())
    np.testing.assert_allclose(answer.json()["rotations"], expected["rotations"], atol=1e-6)
    return answer.json(), expected


@pytest.mark.parametrize("layout", LAYOUTS)
async def test_a_data_folder_of_each_layout_is_served(tmp_path, layout):
    server = Kept(data=folder_of(layout, tmp_path / "data"), refiners=0).start(PATIENCE_S)
    try:
        async with client_of(server) as client:
            ready = (await client.get("/readyz")).json()
            assert (ready["ready"], ready["skipped"]) == (True, [])
            served = {row["name"] for row in (await client.get("/v1/verbs")).json()["verbs"]}
            assert set(FILES) <= served
            await posed(client, "arm", "arm.v1.json", {"adverbs": {"x": 0.3, "y": 0.6}, "phase": 0.5})
            jump = json.loads((GOLDEN / "jump.v2.json").read_text())["adverbs"]
            await posed(client, "jump", "jump.v2.json", {"adverbs": jump, "phase": 0.5})
            first = (await client.get("/v1/verbs/figure/versions")).json()["versions"][-1]
            assert (first["version"], first["author"], first["reason"]) == (1, "ada", "first")
            stored = (await client.get("/v1/verbs/figure/versions/1")).content
            assert stored == (GOLDEN / "contacts.v1.verb").read_bytes()
            (job,) = (await client.get("/v1/refinements")).json()["refinements"]
            assert (job["id"], job["state"], job["request"]["author"]) == ("j1", "not_better", "bob")
    finally:
        server.stop()
    with closing(sqlite3.connect(tmp_path / "data" / "state.db")) as database:
        assert database.execute("SELECT number FROM adverb_layout").fetchall() == [(LAYOUT,)]


def test_every_layout_has_a_folder():
    assert list(LAYOUTS) == list(range(1, LAYOUT + 1))
