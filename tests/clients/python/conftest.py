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
from tests.clients.python.served import serve


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="session")
def catalog() -> Catalog:
    """The built-in verbs."""
    return catalogs.load(None)


@pytest.fixture(scope="session")
def address(catalog) -> Iterator[str]:
    """Address of a real server."""
    with serve(catalog) as address:
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
    """Run the loop until a condition holds."""
    end = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < end, "the condition is not met in time"
        await asyncio.sleep(0.005)


async def next_event(stream: Stream, kind: type, within_s: float = 30.0):
    """The next event of a kind; earlier ones are skipped."""
    async with asyncio.timeout(within_s):
        async for event in stream:
            if isinstance(event, kind):
                return event
    raise AssertionError(f"the stream ended without a event of {kind}")
