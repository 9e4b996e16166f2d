"""Uploads are received by a bounded number, and written outside of the event loop."""

import asyncio
import io
import threading
from types import SimpleNamespace

import pytest

from service.errors import BadUpload, Overloaded
from service.settings import Settings
from service.upload import uploads
from service.upload.builder import MAX_UPLOADS, Builder
from service.upload.drafts import Drafts
from service.upload.uploads import Uploads, receive

pytestmark = pytest.mark.anyio


SYNC = SimpleNamespace(store=SimpleNamespace(drafts=None))
"""Stands for a store that nothing reaches."""


class Body:
    """A body that is received as far as its first byte, and then waits."""

    def __init__(self):
        self.begun, self.ended = asyncio.Event(), asyncio.Event()

    async def chunks(self):
        self.begun.set()
        yield b"P"
        await self.ended.wait()


@pytest.fixture
def made(tmp_path):
    """Uploads and drafts of one builder."""
    builder, folder = Builder(None), tmp_path / "uploads"
    return Uploads(folder, builder, SYNC), Drafts(folder, builder, SYNC, Settings()), folder


async def test_an_upload_without_a_place_is_refused_before_it_is_read(made):
    taken, drafts, folder = made
    bodies = [Body() for _ in range(MAX_UPLOADS)]
    tasks = [
        asyncio.create_task(
            drafts.create(body.chunks(), {}) if k % 2 else taken.publish(body.chunks(), author="ada", expected=None)
        )
        for k, body in enumerate(bodies)
    ]
    await asyncio.gather(*(body.begun.wait() for body in bodies))
    assert len(list(folder.iterdir())) == MAX_UPLOADS
    late = Body()
    with pytest.raises(Overloaded):
        await taken.publish(late.chunks(), author="ada", expected=None)
    with pytest.raises(Overloaded):
        await drafts.create(late.chunks(), {})
    assert not late.begun.is_set()
    assert len(list(folder.iterdir())) == MAX_UPLOADS
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    async with asyncio.timeout(20.0):
        while list(folder.iterdir()):  # noqa: ASYNC110 - a file that is removed has no event
            await asyncio.sleep(0.01)
    again = asyncio.create_task(taken.publish(late.chunks(), author="ada", expected=None))
    await late.begun.wait()
    again.cancel()
    await asyncio.gather(again, return_exceptions=True)


async def test_files_are_written_in_threads(tmp_path):
    class File(io.BytesIO):
        def write(self, block):
            blocks.append((threading.get_ident(), bytes(block)))
            return len(block)

    class Place:
        @staticmethod
        def open(mode):
            blocks.append((threading.get_ident(), b""))
            return File()

    async def chunks():
        for k in range(5):
            yield bytes([k]) * 100

    blocks = []
    await receive(chunks(), Place())
    assert threading.get_ident() not in {thread for thread, _ in blocks}
    assert b"".join(block for _, block in blocks) == b"".join([chunk async for chunk in chunks()])


async def test_an_upload_that_never_ends_is_refused(made, monkeypatch):
    monkeypatch.setattr(uploads, "RECEIVE_S", 0.05)
    taken, _, folder = made
    with pytest.raises(BadUpload, match="within 0.05 s"):
        await taken.publish(Body().chunks(), author="ada", expected=None)
    assert not list(folder.iterdir())
