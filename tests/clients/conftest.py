"""Servers that tests of clients in other languages connect to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import MappingProxyType

import pytest

from service.catalog import catalog as catalogs
from service.catalog.catalog import Catalog
from tests.clients.proxy import Proxy
from tests.service.access.conftest import guarded  # noqa: F401 - a fixture
from tests.service.stream.conftest import Server


@pytest.fixture(scope="package")
def all_verbs() -> Catalog:
    return catalogs.load(None)


@contextmanager
def started(catalog: Catalog, *names: str) -> Iterator[Server]:
    """A server of some of the verbs."""
    served = Server(Catalog(MappingProxyType({name: catalog.entries[name] for name in names}), ())).start()
    try:
        yield served
    finally:
        served.stop()


@pytest.fixture(scope="package")
def server(all_verbs):
    with started(all_verbs, "arm3", "reach", "locomotion") as served:
        yield served


@pytest.fixture(scope="package")
def address(server):
    return f"http://127.0.0.1:{server.port}"


@pytest.fixture
def proxy(server):
    between = Proxy(server.port)
    yield between
    between.close()
