"""Publishing an upload: receive the file, build or check it in a sandbox, publish the verb."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator
from contextlib import suppress
from functools import partial
from pathlib import Path

from service.catalog.store_sync import StoreSync
from service.compute import run_in_own_thread
from service.errors import BadUpload
from service.store.blobs import translated
from service.store.records import Version
from service.upload.archive import is_zip
from service.upload.builder import Builder

__all__ = ["Uploads", "receive"]

RECEIVE_S = 1800.0
"""Longest time for receiving an upload, seconds."""


async def receive(chunks: AsyncIterator[bytes], path: Path) -> None:
    """Write the body of a request to a new file.

    Raises :class:`StoreUnavailable`, or :class:`BadUpload` where it takes longer than :data:`RECEIVE_S`.
    """
    with translated("uploads cannot be written"):
        file = await run_in_own_thread(lambda: path.open("xb"))
        try:
            async with asyncio.timeout(RECEIVE_S):
                async for chunk in chunks:
                    await run_in_own_thread(partial(file.write, chunk))
        except TimeoutError:
            raise BadUpload(f"it was not received within {RECEIVE_S:g} s") from None
        finally:
            await run_in_own_thread(file.close)


def _kept(upload: Path) -> Path | None:
    """The archive to keep as the verb's source; None for an artifact."""
    with translated("uploads cannot be read"), upload.open("rb") as file:
        return upload if is_zip(file.read(4)) else None


def _remove(*paths: Path) -> None:
    for path in paths:
        with suppress(OSError):  # a read-only folder refuses it before it looks for the file
            path.unlink(missing_ok=True)


class Uploads:
    """Receives uploads and publishes the verbs in them.

    Parameters
    ----------
    folder : Path
        Folder of uploads while they are read; created if missing.
    builder : Builder
    sync : StoreSync
    """

    def __init__(self, folder: Path, builder: Builder, sync: StoreSync) -> None:
        self.folder, self._builder, self._sync = folder, builder, sync
        folder.mkdir(parents=True, exist_ok=True)

    async def publish(
        self, chunks: AsyncIterator[bytes], *, author: str, expected: int | None
    ) -> tuple[Version, tuple[str, ...]]:
        """Publish a verb from the bytes of an artifact or of a zip of a verb source, and serve it.

        Parameters
        ----------
        chunks : async iterator of bytes
        author : str
        expected : int or None
            Version that must be current, if given.

        Returns
        -------
        version : Version
        warnings : tuple of str
            Warnings of the build.

        Raises
        ------
        BadUpload
            The upload is not a valid verb.
        Overloaded
            Too many uploads are received or built.
        Conflict, StoreUnavailable
            See :meth:`service.store.store.Store.publish`.
        """
        name = secrets.token_hex(8)
        upload, result = self.folder / f"{name}.upload", self.folder / f"{name}.verb"
        with self._builder.place():  # before the body is read
            try:
                await receive(chunks, upload)
                made = await self._builder.make(upload, result)
                source = await run_in_own_thread(partial(_kept, upload))
                options = {"quality": made.quality, "expected": expected, "source": source}
                version = await self._sync.publish(made.verb, result, author=author, reason="upload", **options)
            finally:
                await run_in_own_thread(partial(_remove, upload, result))
        return version, made.warnings
