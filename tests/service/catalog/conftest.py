"""Servers with a store, and helpers of several tests."""

import asyncio
import io
import time
import zipfile
from pathlib import Path

import httpx
import pytest

from tests.service.refinement.conftest import postgres  # noqa: F401 - a fixture
from tests.service.stream.conftest import Server
from tests.verbs.sources import arm_source

OCTETS, ZIP, JSON = "application/octet-stream", "application/zip", "application/json"
PATIENCE_S = 120.0


class Kept(Server):
    """A server with a data folder; it loads its verbs itself."""

    def __init__(self, **settings):
        super().__init__(None, **settings)
        del self.state.run
        opened = self.state.run

        async def open_here():
            self.loop = asyncio.get_running_loop()
            await opened()

        self.state.run = open_here


def zipped_arm(folder, description=""):
    folder.mkdir(exist_ok=True)
    source = arm_source(folder / "arm")
    with (Path(source) / "verb.toml").open("r+") as file:
        text = file.read()
        file.seek(0)
        file.write(f'description = "{description}"\n{text}' if description else text)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for file in sorted(Path(source).iterdir()):
            archive.writestr(file.name, file.read_bytes())
    return packed.getvalue()


async def until(client, path, holds):
    end = time.monotonic() + PATIENCE_S
    while not holds(answer := (await client.get(path)).json()):
        assert time.monotonic() < end, answer
        await asyncio.sleep(0.1)
    return answer


def client_of(server):
    """An HTTP client of a server."""
    return httpx.AsyncClient(base_url=f"http://127.0.0.1:{server.port}", timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A server with one worker, and an empty data folder."""
    server = Kept(data=tmp_path_factory.mktemp("kept"), refiners=1).start(PATIENCE_S)
    yield server
    server.stop()


@pytest.fixture
async def client(kept):
    async with client_of(kept) as client:
        yield client
