from __future__ import annotations

import asyncio
import sqlite3
import time
from contextlib import aclosing

import pytest

from service.store import notices
from service.store.store import Store
from tests.service.store.children import PROCESSES, publish_on_signal, start

pytestmark = pytest.mark.anyio
BY_ADA = {"author": "ada", "reason": "a test", "quality": {}}


async def until(changes, store, number: int) -> float:
    """Time of the change after which a version is current."""
    async with asyncio.timeout(10):
        async for _ in changes:
            current = await asyncio.to_thread(store.current)
            if "reach" in current and current["reach"].number >= number:
                return time.monotonic()
    raise AssertionError("changes ended")


async def test_what_another_process_publishes_is_noticed_within_a_second(location, tmp_path, monkeypatch):
    monkeypatch.setattr(notices, "REREAD_S", 60.0)  # a notice, not the re-reading
    store = location.open()
    mine, signal = PROCESSES.Pipe()
    times, its = PROCESSES.Pipe(duplex=False)
    child = start(publish_on_signal, location, tmp_path / "child.verb", signal, its)
    assert await asyncio.to_thread(mine.recv) == "ready"
    async with aclosing(store.changes()) as changes:
        await anext(changes)
        for number in range(1, 6):
            mine.send(True)
            noticed = await until(changes, store, number)
            found, published = await asyncio.to_thread(times.recv)
            assert found == number
            assert noticed - published < 1.0
    mine.send(False)
    child.join(60)
    assert child.exitcode == 0
    store.close()


async def test_the_first_notice_is_immediate_and_later_ones_periodic(store, monkeypatch):
    monkeypatch.setattr(notices, "REREAD_S", 0.3)
    began = time.monotonic()
    async with aclosing(store.changes()) as changes:
        for _ in range(3):
            await anext(changes)
    assert 0.5 < time.monotonic() - began < 5.0


async def test_jobs_and_usage_cause_no_notice(store, artifact, monkeypatch):
    monkeypatch.setattr(notices, "REREAD_S", 60.0)
    async with aclosing(store.changes()) as changes:
        await anext(changes)
        store.put_usage("reach", "a", {}, 1.0)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.5):
                await anext(changes)


@pytest.mark.parametrize("act", ["activate", "delete"])
async def test_activating_and_deleting_are_noticed(store, artifact, monkeypatch, act):
    monkeypatch.setattr(notices, "REREAD_S", 60.0)
    for text in ("one", "two"):
        store.publish("reach", artifact(text), **BY_ADA)
    async with aclosing(store.changes()) as changes, asyncio.timeout(5):
        await anext(changes)
        if act == "delete":
            store.delete("reach", author="ada", reason="")
        else:
            store.activate("reach", 1, author="ada", reason="")
        await anext(changes)


async def test_changes_end_when_the_store_is_closed(store, monkeypatch):
    monkeypatch.setattr(notices, "REREAD_S", 0.2)
    async with asyncio.timeout(5):
        async for _ in store.changes():
            store.close()


async def test_changes_survive_a_restart_of_postgresql(postgres, folder, artifact, monkeypatch):
    monkeypatch.setattr(notices, "REREAD_S", 60.0)
    store = Store.open(postgres.database(), str(folder))
    async with aclosing(store.changes()) as changes, asyncio.timeout(20):
        await anext(changes)
        postgres.stop()
        try:
            for _ in range(3):
                await anext(changes)
            assert not store.available
        finally:
            postgres.start()
        while not store.available:
            await anext(changes)
        store.publish("reach", artifact("one"), **BY_ADA)
        await until(changes, store, 1)
    store.close()


async def test_changes_survive_a_frozen_postgresql(postgres, folder, artifact, monkeypatch):
    monkeypatch.setattr(notices, "REREAD_S", 0.2)
    store = Store.open(postgres.database(), str(folder))
    async with aclosing(store.changes()) as changes, asyncio.timeout(20):
        await anext(changes)
        with postgres.frozen():
            while store.available:
                await anext(changes)
        while not store.available:
            await anext(changes)
        store.publish("reach", artifact("one"), **BY_ADA)
        await until(changes, store, 1)
    store.close()


async def test_changes_survive_an_unreadable_file(folder, monkeypatch):
    monkeypatch.setattr(notices, "BACK_OFF_S", 0.05)
    store = Store.open(f"sqlite:///{folder}/state.db", str(folder / "artifacts"))
    file, away = folder / "state.db", folder / "away.db"
    async with aclosing(store.changes()) as changes, asyncio.timeout(10):
        await anext(changes)
    store._database._engine.dispose()
    file.rename(away)
    async with aclosing(store.changes()) as changes, asyncio.timeout(10):
        await anext(changes)
        assert not store.available
        assert not file.exists()  # looking made no empty one
        away.rename(file)
        while not store.available:
            await anext(changes)
    with sqlite3.connect(file) as connection:
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    connection.close()
    store.close()
