"""What a job keeps between its steps: blobs beside the artifacts, under ``jobs/<job>``, gone when the job is."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from service.store.blobs import Blob, Folder, open_blobs
from verbs.io import artifact
from verbs.verb import Verb

__all__ = ["KEPT", "Scratch"]

KEPT = 4
"""Latest checkpoints that are kept: the one to go on from, and some for a worker that lags behind."""


class Scratch:
    """Blobs of one job, named by their hashes: writing one again changes nothing.

    Parameters
    ----------
    artifacts : str
        Where the store's artifacts lie.
    job : str
    cache : Path, optional
        Local folder for what an object store keeps.
    """

    def __init__(self, artifacts: str, job: str, *, cache: Path | None = None) -> None:
        place = f"{artifacts.rstrip('/')}/jobs/{job}"
        copies = (cache or Path(tempfile.gettempdir()) / "adverb-cache") / "jobs" / job
        self._blobs = open_blobs(place, cache=copies)

    def put(self, data: bytes) -> str:
        """Keep bytes; returns their name."""
        with tempfile.TemporaryDirectory(prefix="adverb-") as folder:
            path = Path(folder) / "blob"
            path.write_bytes(data)
            return str(self._blobs.put(path, lambda step: None).sha256)

    def put_verb(self, verb: Verb) -> str:
        """Keep a verb's file; returns its name, which is what it will be published as."""
        with tempfile.TemporaryDirectory(prefix="adverb-") as folder:
            path = Path(folder) / "blob.verb"
            artifact.save(verb, path)
            return str(self._blobs.put(path, lambda step: None).sha256)

    def get(self, name: str) -> bytes:
        """Bytes by their name."""
        return self.path(name).read_bytes()

    def path(self, name: str) -> Path:
        """A local file by its name."""
        return self._blobs.path(name)

    def latest(self, names: Sequence[str], name: str) -> list[str]:
        """The names to keep after one more; removes what is too old."""
        kept = [*(one for one in names if one != name), name]
        self._blobs.remove(Blob(f"{one}.verb", one, 0, 0.0) for one in kept[:-KEPT])
        return kept[-KEPT:]

    def clear(self) -> None:
        """Remove all of it."""
        for place in (self._blobs, self._blobs.cache):
            if place is not None:
                place.remove(place.listing())
            if isinstance(place, Folder):
                with suppress(OSError):  # something else lies there, or somebody else was faster
                    place.root.rmdir()
