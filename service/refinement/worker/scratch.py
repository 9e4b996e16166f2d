"""Blobs of a job, under ``jobs/<job>`` beside the artifacts; removed when the job ends."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from service.store.blobs import Blob, Folder, open_blobs, translated
from service.store.records import StoreUnavailable
from verbs.errors import ArtifactError
from verbs.io import artifact
from verbs.verb import Verb

__all__ = ["KEPT", "Scratch"]

KEPT = 4
"""Number of checkpoints to keep: the latest, and some for a worker that lags behind."""


UNWRITABLE = "temporary files of a job cannot be written"


class Scratch:
    """Blobs of one job, named by their hashes, so that writing one again changes nothing.

    Parameters
    ----------
    artifacts : str
        Address of the store's artifacts.
    job : str
    cache : Path, optional
        Local folder for copies of an object store's blobs.
    """

    def __init__(self, artifacts: str, job: str, *, cache: Path | None = None) -> None:
        place = f"{artifacts.rstrip('/')}/jobs/{job}"
        copies = (cache or Path(tempfile.gettempdir()) / "adverb-cache") / "jobs" / job
        self._blobs = open_blobs(place, cache=copies)

    def put(self, data: bytes) -> str:
        """Store bytes; returns their name. Raises :class:`StoreUnavailable`, as where a disk is full."""
        with translated(UNWRITABLE), tempfile.TemporaryDirectory(prefix="adverb-") as folder:
            path = Path(folder) / "blob"
            path.write_bytes(data)
            return str(self._blobs.put(path, lambda step: None).sha256)

    def put_verb(self, verb: Verb) -> str:
        """Store a verb as an artifact; returns its name, which is the hash that it is published under."""
        with translated(UNWRITABLE), tempfile.TemporaryDirectory(prefix="adverb-") as folder:
            path = Path(folder) / "blob.verb"
            try:
                artifact.save(verb, path)
            except ArtifactError as err:
                raise StoreUnavailable(f"{UNWRITABLE}: {err.problem}") from err
            return str(self._blobs.put(path, lambda step: None).sha256)

    def get(self, name: str) -> bytes:
        """Bytes by their name."""
        return self.path(name).read_bytes()

    def path(self, name: str) -> Path:
        """A local file by its name."""
        return self._blobs.path(name)

    def latest(self, names: Sequence[str], name: str) -> list[str]:
        """Add a name to the list of kept blobs, and remove the oldest ones beyond :data:`KEPT`."""
        kept = [*(one for one in names if one != name), name]
        self._blobs.remove(Blob(f"{one}.verb", one, 0, 0.0) for one in kept[:-KEPT])
        return kept[-KEPT:]

    def clear(self) -> None:
        """Remove all blobs of the job."""
        for place in (self._blobs, self._blobs.cache):
            if place is not None:
                place.remove(place.listing())
            if isinstance(place, Folder):
                with suppress(OSError):  # not empty, or removed by another process
                    place.root.rmdir()
