"""Files of verbs in the data folder."""

import hashlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from service.catalog.catalog import Catalog
from service.catalog.store_sync import StoreSync
from service.store.store import Store
from verbs import library
from verbs.io import artifact


def opened(folder):
    return Store.open(f"sqlite:///{folder / 'state.db'}", str(folder / "artifacts"))


def test_servers_that_start_together_serve_the_folder_s_verb_in_place_of_the_built_in_one(tmp_path):
    data, own = tmp_path / "data", tmp_path / "data" / "arm3.verb"
    data.mkdir()
    artifact.save(replace(library.load("arm3"), description="ours"), own)
    syncs = [StoreSync(opened(tmp_path), data, current=Catalog, set_catalog=lambda catalog: None) for _ in range(3)]
    with ThreadPoolExecutor(len(syncs)) as threads:
        catalogs = list(threads.map(StoreSync.load, syncs))
    current = syncs[0].store.current()["arm3"]
    assert current.sha256 == hashlib.sha256(own.read_bytes()).hexdigest()
    assert [version.number for version in syncs[0].store.versions("arm3")] == [1, 2]
    for sync, catalog in zip(syncs, catalogs, strict=True):
        assert catalog.skipped == ()
        assert sync.read(catalog).entries["arm3"].verb.description == "ours"
        sync.store.close()
