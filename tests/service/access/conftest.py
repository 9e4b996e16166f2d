"""A server with a store and keys of every kind."""

from __future__ import annotations

import time
from dataclasses import dataclass

import pytest

from service.access.keys import hash_of, new
from service.store.keys import Keys, open_keys
from tests.service.catalog.conftest import PATIENCE_S, Kept, client_of


@dataclass
class Guarded:
    """A server, its keys by name, and their table."""

    server: Kept
    keys: dict[str, str]
    store: Keys


def added(store: Keys, *scopes: str, name: str = "", expires_at_s: float | None = None) -> str:
    """A new key."""
    id, text = new()
    store.add(id, hash_of(text), name=name, scopes=frozenset(scopes), expires_at_s=expires_at_s)
    return text


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("guarded")
    store = open_keys(f"sqlite:///{folder / 'state.db'}")
    keys = {scope: added(store, scope, name=f"of {scope}") for scope in ("pose", "author", "refine", "admin")}
    keys["expired"] = added(store, "admin", expires_at_s=time.time() - 1.0)
    keys["revoked"] = added(store, "admin")
    store.revoke(keys["revoked"].split("_")[1])
    server = Kept(data=folder, refiners=0).start(PATIENCE_S)
    yield Guarded(server, keys, store)
    server.stop()
    store.close()


@pytest.fixture
async def client(guarded, anyio_backend):
    async with client_of(guarded.server) as client:
        yield client


def bearer(key: str) -> dict[str, str]:
    """Header with a key."""
    return {"Authorization": f"Bearer {key}"}
