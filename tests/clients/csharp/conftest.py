from __future__ import annotations

from types import MappingProxyType

import pytest

from service.catalog import catalog as catalogs
from service.catalog.catalog import Catalog
from tests.clients.csharp.mono import CLIENT, PROGRAMS, compile_cs, missing
from tests.clients.proxy import Proxy
from tests.service.access.conftest import guarded  # noqa: F401 - a fixture
from tests.service.stream.conftest import Server


def pytest_collection_modifyitems(items):
    problem = missing()
    for item in items:
        if problem and item.path.parent.name == "csharp":
            item.add_marker(pytest.mark.skip(reason=problem))


@pytest.fixture(scope="package")
def built(tmp_path_factory):
    """Folder of the compiled client and test programs."""
    folder = tmp_path_factory.mktemp("csharp")
    client = folder / "Adverb.dll"
    compile_cs(client, [CLIENT / "Adverb.cs"], "System.Net.Http.dll", library=True)
    compile_cs(folder / "tests.exe", sorted(PROGRAMS.glob("*.cs")), str(client))
    return folder


@pytest.fixture(scope="package")
def program(built):
    """The compiled test programs."""
    return built / "tests.exe"


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
