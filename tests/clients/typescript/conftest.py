from __future__ import annotations

from types import MappingProxyType

import pytest

from service.catalog import catalog as catalogs
from service.catalog.catalog import Catalog
from tests.clients.proxy import Proxy
from tests.clients.typescript.node import missing
from tests.service.access.conftest import guarded  # noqa: F401 - a fixture
from tests.service.stream.conftest import Server


def pytest_collection_modifyitems(items):
    problem = missing()
    for item in items:
        if problem and item.path.parent.name == "typescript":
            item.add_marker(pytest.mark.skip(reason=problem))


@pytest.fixture(scope="package")
def all_verbs() -> Catalog:
    return catalogs.load(None)


@pytest.fixture(scope="module")
def server(all_verbs):
    entries = {name: all_verbs.entries[name] for name in ("arm3", "reach")}
    served = Server(Catalog(MappingProxyType(entries), ())).start()
    yield served
    served.stop()


@pytest.fixture(scope="module")
def address(server):
    return f"http://127.0.0.1:{server.port}"


@pytest.fixture
def proxy(server):
    between = Proxy(server.port)
    yield between
    between.close()
