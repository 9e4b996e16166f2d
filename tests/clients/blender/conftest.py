from __future__ import annotations

import sys
from pathlib import Path

import pytest

from service.catalog import catalog as catalogs
from tests.clients.python.served import serve

sys.path.append(str(Path(__file__).parents[3] / "clients" / "blender"))  # Blender installs the add-on as a folder


@pytest.fixture(scope="package")
def all_verbs():
    return catalogs.load(None)


@pytest.fixture(scope="package")
def address(all_verbs):
    with serve(all_verbs) as address:
        yield address
