"""Publishing an upload: receive the file, build or check it in a sandbox, publish the verb."""

from __future__ import annotations

import secrets
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

from service.catalog.store_sync import StoreSync
from service.store.blobs import translated
from service.store.records import Version
from service.upload.archive import is_zip
from service.upload.builder import Builder

__all__ = ["Uploads", "receive"]


async def receive(chunks: AsyncIterator[bytes], path: Path) -> None:
    """Write the body of a request to a new file; raises :class:`StoreUnavailable`."""
    with translated("uploads cannot be written"), path.open("xb") as file:
        async for chunk in chunks:
            file.write(chunk)


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
            Too many uploads are waiting.
        Conflict, StoreUnavailable
            See :meth:`service.store.store.Store.publish`.
        """
        name = secrets.token_hex(8)
        upload, result = self.folder / f"{name}.upload", self.folder / f"{name}.verb"
        try:
            await receive(chunks, upload)
            made = await self._builder.make(upload, result)
            with upload.open("rb") as file:
                source = upload if is_zip(file.read(4)) else None
            options = {"quality": made.quality, "expected": expected, "source": source}
            version = await self._sync.publish(made.verb, result, author=author, reason="upload", **options)
        finally:
            for path in (upload, result):
                with suppress(OSError):  # a read-only folder refuses it before it looks for the file
                    path.unlink(missing_ok=True)
        return version, made.warnings
