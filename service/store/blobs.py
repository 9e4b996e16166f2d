"""Where artifacts lie: immutable blobs ``<sha256>.verb`` in a folder, or in an object store behind a local cache."""

from __future__ import annotations

import hashlib
import os
import re
import secrets
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Protocol
from urllib.parse import unquote, urlsplit

from service.store.records import ArtifactMissing, BadAddress, StoreUnavailable
from verbs.errors import ArtifactError

if TYPE_CHECKING:
    from obstore.store import ObjectStore

__all__ = ["Blob", "Blobs", "Bucket", "Folder", "open_blobs"]

SCHEMES = ("s3", "gs", "az", "memory")
"""Object stores that :func:`open_blobs` knows; all need the extra ``s3``."""

CHUNK_BYTES = 1024 * 1024

_NAME = re.compile(r"([0-9a-f]{64})\.verb")
_PART = re.compile(r"\.[0-9a-f]{16}\.tmp")

At = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Blob:
    """A file of the store; ``sha256`` is None for the temporary file of a publisher that did not finish."""

    name: str
    sha256: str | None
    size_bytes: int
    modified_at_s: float


class Blobs(Protocol):
    """A place for artifacts."""

    def put(self, source: Path, at: At) -> Blob:
        """Copy a file into the place, whole or not at all; ``at`` is told each step."""
        ...

    def has(self, sha256: str) -> bool:
        """Whether a blob is there."""
        ...

    def path(self, sha256: str) -> Path:
        """A local file with a blob's bytes, checked; raises :class:`ArtifactMissing`."""
        ...

    def listing(self) -> list[Blob]:
        """Every file of the store, temporary ones too; foreign files are not listed."""
        ...

    def remove(self, blobs: Iterable[Blob]) -> None:
        """Remove files; those that are gone already do not matter."""
        ...

    @property
    def cache(self) -> Folder | None:
        """The folder of copies, where the blobs themselves are elsewhere."""
        ...


def open_blobs(address: str, *, cache: Path | None = None) -> Blobs:
    """The place that an address names: a folder, ``file://…`` or ``s3://bucket/prefix`` (also gs, az, memory).

    Raises
    ------
    BadAddress
        Its scheme is unknown, or needs a package that is not installed.
    StoreUnavailable
        The folder cannot be made.
    """
    scheme, colon, _ = address.partition("://")
    if not colon:
        return Folder(Path(address))
    if scheme == "file":
        return Folder(Path(unquote(urlsplit(address).path)))
    if scheme not in SCHEMES:
        known = ", ".join(f"{name}://" for name in ("file", *SCHEMES))
        raise BadAddress(f"artifacts lie in a folder or at {known}, not at '{scheme:.40}://'")
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Bucket(_object_store(address), Folder(cache or home / "adverb"))


class Folder:
    """Blobs in one folder of a local disk or a shared volume.

    Parameters
    ----------
    root : Path
        Made where it is not there. Raises :class:`StoreUnavailable` where it cannot be.
    """

    cache: Folder | None = None

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        self._checked: dict[str, tuple[int, int, int]] = {}
        with _reached("the artifacts' folder cannot be made"):
            self.root.mkdir(parents=True, exist_ok=True)

    def put(self, source: Path, at: At) -> Blob:
        """Copy a file: temporary name, fsync, rename to its hash, fsync of the folder. Nothing half can be seen.

        Raises :class:`ArtifactError` where the source cannot be read, and :class:`StoreUnavailable` where the folder
        cannot be written.
        """
        try:
            file = source.open("rb")
        except OSError as err:
            raise ArtifactError(source, f"cannot be opened: {err.strerror or err}") from err
        with file:
            return self.write(iter(partial(file.read, CHUNK_BYTES), b""), at)

    def write(self, chunks: Iterable[bytes], at: At, *, expected: str | None = None) -> Blob:
        """Write a blob from its bytes; raises :class:`ArtifactMissing` where they do not hash as ``expected``."""
        part = self.root / f".{secrets.token_hex(8)}.tmp"
        digest, size = hashlib.sha256(), 0
        with _reached("artifacts cannot be written"):
            try:
                at("write")
                with part.open("xb") as file:
                    for chunk in chunks:
                        digest.update(chunk)
                        size += len(chunk)
                        file.write(chunk)
                    at("sync")
                    file.flush()
                    os.fsync(file.fileno())
                    modified_at_s = os.fstat(file.fileno()).st_mtime
                sha256 = digest.hexdigest()
                if expected not in (None, sha256):
                    raise ArtifactMissing(str(expected), "is damaged where it is kept")
                at("rename")
                part.replace(self._file(sha256))
                at("sync_folder")
                _sync(self.root)
            finally:
                part.unlink(missing_ok=True)
        return Blob(f"{sha256}.verb", sha256, size, modified_at_s)

    def has(self, sha256: str) -> bool:
        """Whether a blob is there."""
        with _reached("artifacts cannot be read"):
            return self._file(sha256).exists()

    def path(self, sha256: str) -> Path:
        """A blob's file. Its bytes are checked when this process first meets it, and when it changed since.

        Raises :class:`ArtifactMissing` where it is not there or damaged.
        """
        path = self._file(sha256)
        with _reached("artifacts cannot be read"):
            try:
                with path.open("rb") as file:
                    facts = os.fstat(file.fileno())
                    mark = (facts.st_ino, facts.st_size, facts.st_mtime_ns)
                    sound = self._checked.get(sha256) == mark
                    sound = sound or hashlib.file_digest(file, "sha256").hexdigest() == sha256
            except FileNotFoundError:
                raise ArtifactMissing(sha256, "is not there; it may have been collected") from None
        if not sound:
            raise ArtifactMissing(sha256, "is damaged")
        self._checked[sha256] = mark
        return path

    def listing(self) -> list[Blob]:
        """Every blob and every temporary file of a publisher."""
        found = []
        with _reached("artifacts cannot be listed"), os.scandir(self.root) as entries:
            for entry in entries:
                match = _NAME.fullmatch(entry.name)
                if match is None and _PART.fullmatch(entry.name) is None:
                    continue
                with suppress(FileNotFoundError):  # somebody else removes it
                    facts = entry.stat()
                    found.append(Blob(entry.name, match and match[1], facts.st_size, facts.st_mtime))
        return sorted(found, key=lambda blob: blob.name)

    def remove(self, blobs: Iterable[Blob]) -> None:
        """Unlink files; whoever has mapped one goes on reading it."""
        with _reached("artifacts cannot be removed"):
            for blob in blobs:
                (self.root / blob.name).unlink(missing_ok=True)
                self._checked.pop(blob.sha256 or "", None)

    def _file(self, sha256: str) -> Path:
        return self.root / f"{sha256}.verb"


class Bucket:
    """Blobs in an object store; what is read lies in a local folder by its hash.

    Parameters
    ----------
    store : obstore.store.ObjectStore
    cache : Folder
        May be shared by the processes of one machine.
    """

    def __init__(self, store: ObjectStore, cache: Folder) -> None:
        self._store = store
        self.cache: Folder | None = cache
        self._copies = cache

    def put(self, source: Path, at: At) -> Blob:
        """Copy a file into the cache and then into the object store, where it appears whole or not at all.

        Raises :class:`ArtifactError` where the source cannot be read, and :class:`StoreUnavailable` where the bucket
        cannot be written.
        """
        import obstore

        blob = self._copies.put(source, at)
        at("upload")
        with _reached("the bucket cannot be written"):
            obstore.put(self._store, blob.name, self._copies.path(str(blob.sha256)))
        return blob

    def has(self, sha256: str) -> bool:
        """Whether a blob is in the object store."""
        import obstore

        with _reached("the bucket cannot be read"):
            try:
                obstore.head(self._store, f"{sha256}.verb")
            except FileNotFoundError:
                return False
        return True

    def path(self, sha256: str) -> Path:
        """The cached file, fetched where it is not there or not sound; raises :class:`ArtifactMissing`."""
        import obstore

        with suppress(ArtifactMissing):
            return self._copies.path(sha256)
        with _reached("the bucket cannot be read"):
            try:
                chunks = (bytes(chunk) for chunk in obstore.get(self._store, f"{sha256}.verb").stream())
                first = next(chunks, b"")
            except FileNotFoundError:
                raise ArtifactMissing(sha256, "is not in the bucket; it may have been collected") from None
            self._copies.write(chain([first], chunks), lambda step: None, expected=sha256)
        return self._copies.path(sha256)

    def listing(self) -> list[Blob]:
        """Every blob of the object store."""
        import obstore

        found = []
        with _reached("the bucket cannot be listed"):
            for row in chain.from_iterable(obstore.list(self._store)):
                match = _NAME.fullmatch(row["path"])
                if match:
                    found.append(Blob(match[0], match[1], row["size"], row["last_modified"].timestamp()))
        return sorted(found, key=lambda blob: blob.name)

    def remove(self, blobs: Iterable[Blob]) -> None:
        """Delete blobs from the object store; the cache is another matter."""
        import obstore

        with _reached("blobs of the bucket cannot be removed"):
            for blob in blobs:
                with suppress(FileNotFoundError):
                    obstore.delete(self._store, blob.name)


def _object_store(address: str) -> ObjectStore:
    """Object store of an address; keys and endpoint come from the environment (``AWS_…``), never from the address."""
    try:
        from obstore.exceptions import BaseError
        from obstore.store import from_url
    except ImportError as err:
        raise BadAddress(f"{address.partition(':')[0]}:// needs the extra 's3': install adverb[s3]") from err
    if address.startswith("memory:"):
        return from_url(address)
    try:
        return from_url(
            address,
            client_options={"connect_timeout": "5s", "read_timeout": "5s", "timeout": "120s"},
            retry_config={"max_retries": 3, "retry_timeout": timedelta(seconds=15)},
        )
    except (BaseError, ValueError) as err:
        raise BadAddress(f"the bucket cannot be opened: {_line(err)}") from err


@contextmanager
def _reached(problem: str) -> Iterator[None]:
    """Turn failures of disks and networks into :class:`StoreUnavailable`."""
    try:
        yield
    except OSError as err:
        raise StoreUnavailable(f"{problem}: {err.strerror or _line(err)}") from err
    except Exception as err:
        if type(err).__module__.partition(".")[0] != "obstore":  # imported only where it is used
            raise
        raise StoreUnavailable(f"{problem}: {_line(err)}") from err


def _line(err: Exception) -> str:
    return (str(err).strip().splitlines() or [type(err).__name__])[0][:200]


def _sync(folder: Path) -> None:
    """Make the names in a folder survive a loss of power."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
