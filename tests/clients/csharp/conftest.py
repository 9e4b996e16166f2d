from __future__ import annotations

import pytest

from tests.clients.csharp.mono import CLIENT, PROGRAMS, compile_cs, missing


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
