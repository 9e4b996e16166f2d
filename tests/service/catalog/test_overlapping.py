"""Readings of the store that overlap."""

import asyncio
import threading
from pathlib import Path

import pytest

from service.catalog.catalog import Catalog
from service.catalog.store_sync import StoreSync
from service.compute import run_in_thread
from service.store.store import Store
from tests.service.catalog.conftest import PATIENCE_S
from verbs import library

FOLDER = Path(library.__file__).parent


@pytest.mark.anyio
async def test_a_slow_reading_does_not_bring_back_what_was_deleted(tmp_path):
    """A reading of the store that began before a deletion, and ends after it, is not served."""
    store = Store.open(f"sqlite:///{tmp_path / 'state.db'}", str(tmp_path / "artifacts"))
    served = [Catalog()]
    sync = StoreSync(store, tmp_path, current=lambda: served[-1], set_catalog=served.append)
    for name in ("arm3", "board"):
        store.publish(name, FOLDER / f"{name}.verb", author="ada", reason="", quality={})
    begun, resumed = threading.Event(), threading.Event()
    current = store.current

    def slow():
        found = current()
        begun.set()
        assert resumed.wait(PATIENCE_S)
        return found

    store.current = slow
    reading = asyncio.create_task(sync.refresh())
    await run_in_thread(begun.wait)
    store.current = current
    deletion = asyncio.create_task(sync.delete("arm3", author="ada", reason=""))
    while "arm3" in current():  # noqa: ASYNC110 - the store has no event for it
        await asyncio.sleep(0.01)
    await asyncio.sleep(0)
    resumed.set()
    await asyncio.gather(reading, deletion)
    assert list(served[-1].entries) == ["board"]
    store.close()
