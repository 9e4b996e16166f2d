from __future__ import annotations

from types import MappingProxyType

import pytest

from service.catalog import catalog as catalogs
from service.catalog.catalog import Catalog
from tests.clients.godot.godot import make_project, missing
from tests.clients.proxy import Proxy
from tests.service.access.conftest import guarded  # noqa: F401 - a fixture
from tests.service.stream.conftest import Server


@pytest.fixture(scope="package")
def project(tmp_path_factory):
    """A project of Godot 3 with the addon and the test programs."""
    if problem := missing():
        pytest.skip(problem)
    return make_project(tmp_path_factory.mktemp("godot"))


@pytest.fixture(scope="package")
def all_verbs() -> Catalog:
    return catalogs.load(None)


@pytest.fixture(scope="package")
def server(all_verbs):
    entries = {name: all_verbs.entries[name] for name in ("arm3", "reach", "locomotion")}
    served = Server(Catalog(MappingProxyType(entries), ())).start()
    yield served
    served.stop()


@pytest.fixture(scope="package")
def address(server):
    return f"http://127.0.0.1:{server.port}"


@pytest.fixture
def proxy(server):
    between = Proxy(server.port)
    yield between
    between.close()
