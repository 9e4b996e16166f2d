from __future__ import annotations

import pytest

from tests.clients.godot.godot import make_project, missing


@pytest.fixture(scope="package")
def project(tmp_path_factory):
    """A project of Godot 3 with the addon and the test programs."""
    if problem := missing():
        pytest.skip(problem)
    return make_project(tmp_path_factory.mktemp("godot"))
