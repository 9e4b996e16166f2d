from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import httpx
import numpy as np
import pytest
import structlog
from fastapi import FastAPI

from service.app import create_app
from service.catalog import catalog as catalogs
from service.catalog.catalog import Catalog
from service.settings import Settings
from tests.verbs.sources import SKELETON, example_row, write_source
from verbs.authoring.fit import build
from verbs.io import artifact
from verbs.kernels import quat
from verbs.motion import Motion

ARM = {"x": 0.4, "y": 0.3}
SWAY = {"width": 0.5, "haste": 0.5}


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="session", autouse=True)
def _quiet() -> None:
    """Nothing is logged; `structlog.testing.capture_logs` still sees it."""

    def drop(*_):
        raise structlog.DropEvent

    structlog.configure(processors=[drop])


@pytest.fixture(scope="session")
def data_dir(tmp_path_factory) -> Path:
    """A data folder: a looping verb of style adverbs, and two files that are no verbs."""
    folder = tmp_path_factory.mktemp("data")
    verb = build(sway_source(tmp_path_factory.mktemp("sway"))).verb
    artifact.save(verb, folder / "sway.verb")
    cut = (folder / "sway.verb").read_bytes()
    (folder / "cut.verb").write_bytes(cut[: len(cut) // 2])
    (folder / "noise.verb").write_bytes(b"not a verb" * 10)
    return folder


def sway_source(folder: Path) -> Path:
    """Four loops that walk ahead and turn, wider or hastier; nothing about them can be measured."""
    motions, rows = {}, []
    for k, (width, haste) in enumerate([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]):
        frames = 31 if haste else 41
        share = np.linspace(0.0, 1.0, frames)
        vectors = np.zeros((frames, 3, 3))
        vectors[:, 0, 1] = 0.2 * width * share
        vectors[:, 1, 2] = (0.3 + 0.3 * width) * np.sin(2 * np.pi * share)
        root = np.stack([0 * share, 1.0 + 0 * share, (0.5 + haste) * share], axis=-1)
        name = f"sway{k}"
        motions[name] = Motion(SKELETON, 30.0, root, quat.exp(vectors))
        end = (frames - 1) / 30.0
        rows.append(example_row(name, [0.0, 0.4 * end, end], [width, haste]))
    head = (
        'name = "sway"\nlooping = true\nkeytime_names = ["left", "right", "left again"]\n'
        '[[adverb]]\nname = "width"\nunit = "1"\nstyle = true\n[[adverb]]\nname = "haste"\nunit = "1"\nstyle = true\n'
    )
    return write_source(folder, motions, rows, head)


@pytest.fixture(scope="session")
def catalog(data_dir) -> Catalog:
    """The built-in verbs and those of the data folder, loaded once."""
    return catalogs.load(data_dir)


def app_of(catalog: Catalog | None, **settings) -> FastAPI:
    """An app that serves a catalog already loaded, or (None) nothing yet."""
    app = create_app(Settings(**settings))
    if catalog is not None:
        app.state.server.set_catalog(catalog)
    return app


@asynccontextmanager
async def client_of(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    """A client that talks to an app in this process."""
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
        yield client


@pytest.fixture
def app(catalog) -> FastAPI:
    return app_of(catalog)


@pytest.fixture
async def client(app, anyio_backend) -> AsyncIterator[httpx.AsyncClient]:
    async with client_of(app) as client:
        yield client


@pytest.fixture(scope="session")
def serve(catalog):
    """Start servers with settings; each is stopped where the block ends."""

    @contextmanager
    def started(**settings):
        from tests.service.stream.conftest import Server  # which needs this module

        server = Server(catalog, **settings).start()
        try:
            yield server
        finally:
            server.stop()

    return started
