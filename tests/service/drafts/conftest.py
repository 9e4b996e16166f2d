"""Servers with drafts, and zips of clips."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import pytest

from tests.service.catalog.conftest import PATIENCE_S, ZIP, Kept, client_of
from tests.verbs import raw_folder

NAME = "reaches"


def packed(folder: Path, *, prefix: str = "", without: tuple[str, ...] = ()) -> bytes:
    """A zip of the files of a folder."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.iterdir()):
            if path.name not in without:
                archive.writestr(prefix + path.name, path.read_bytes())
    return content.getvalue()


@pytest.fixture(scope="session")
def reaches(tmp_path_factory) -> bytes:
    """A zip of nine reaches, without verb.toml."""
    return packed(raw_folder.write(tmp_path_factory.mktemp("reaches") / "clips", raw_folder.reaches()))


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A server without workers, and an empty data folder."""
    server = Kept(data=tmp_path_factory.mktemp("drafts"), refiners=0).start(PATIENCE_S)
    yield server
    server.stop()


@pytest.fixture
async def client(kept, anyio_backend):
    async with client_of(kept) as client:
        yield client


async def created(client, content: bytes, **query):
    """A new draft."""
    answer = await client.post("/v1/drafts", content=content, headers={"Content-Type": ZIP}, params=query)
    assert answer.status_code == 201, answer.text
    return answer.json()


@pytest.fixture
async def draft(client, reaches):
    """A draft of the reaches, deleted after the test."""
    made = await created(client, reaches, name=NAME)
    yield made
    await client.delete(f"/v1/drafts/{made['id']}")
