from __future__ import annotations

import pytest

from tests.clients.conftest import started
from tests.clients.typescript.node import missing


def pytest_collection_modifyitems(items):
    problem = missing()
    for item in items:
        if problem and item.path.parent.name == "typescript":
            item.add_marker(pytest.mark.skip(reason=problem))


@pytest.fixture(scope="module")
def server(all_verbs):
    """Tests count its sessions."""
    with started(all_verbs, "arm3", "reach") as served:
        yield served


@pytest.fixture(scope="module")
def address(server):
    return f"http://127.0.0.1:{server.port}"
