from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable, Iterator

import pytest
from adverb_client import Backoff, Stream

from service.catalog import catalog as catalogs
from service.catalog.catalog import Catalog
from tests.clients.python.fake import FakeServer, running
from tests.clients.python.served import serving


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="session")
def catalog() -> Catalog:
    """The built-in verbs, loaded once."""
    return catalogs.load(None)


@pytest.fixture(scope="session")
def address(catalog) -> Iterator[str]:
    """Where the real server is."""
    with serving(catalog) as address:
        yield address


@pytest.fixture
async def fake(anyio_backend):
    async with running() as server:
        yield server


def quick() -> Backoff:
    return Backoff(0.01, 0.05, random.Random(1))


@pytest.fixture
async def stream(fake: FakeServer):
    async with Stream(fake.url, backoff=quick()) as stream:
        yield stream


async def until(true: Callable[[], object], within_s: float = 30.0) -> None:
    """Let the loop run until something is true."""
    end = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < end, "it did not come true in time"
        await asyncio.sleep(0.005)


async def next_note(stream: Stream, kind: type, within_s: float = 30.0):
    """The next note of a kind; those before it are passed over."""
    async with asyncio.timeout(within_s):
        async for note in stream:
            if isinstance(note, kind):
                return note
    raise AssertionError(f"the stream ended without a note of {kind}")
