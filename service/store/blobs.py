"""Storage of artifacts: immutable blobs ``<sha256>.verb`` in a folder, or in an object store with a local cache."""

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

from service.store.records import ArtifactDamaged, ArtifactMissing, BadAddress, StoreUnavailable
from verbs.errors import ArtifactError

if TYPE_CHECKING:
    from obstore.store import ObjectStore

__all__ = ["Blob", "Blobs", "Bucket", "Folder", "open_blobs", "sync_folder", "translated"]

SCHEMES = ("s3", "gs", "az", "memory")
"""Schemes of object stores; all need the extra ``s3``."""

CHUNK_BYTES = 1024 * 1024

_NAME = re.compile(r"([0-9a-f]{64})\.verb")
_PART = re.compile(r"\.[0-9a-f]{16}\.tmp")

At = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Blob:
    """A file of the storage; ``sha256`` is None for temporary files."""

    name: str
    sha256: str | None
    size_bytes: int
    modified_at_s: float


class Blobs(Protocol):
    """Storage of artifacts."""

    def put(self, source: Path, at: At) -> Blob:
        """Copy a file into the storage atomically; ``at`` is called before each step."""
        ...

    def has(self, sha256: str) -> bool:
        """Whether a blob exists."""
        ...

    def path(self, sha256: str) -> Path:
        """A local file with a blob, checked against its hash; raises ArtifactMissing or ArtifactDamaged."""
        ...

    def listing(self) -> list[Blob]:
        """All blobs and temporary files; other files are ignored."""
        ...

    def remove(self, blobs: Iterable[Blob]) -> None:
        """Remove files; missing ones are ignored."""
        ...

    @property
    def cache(self) -> Folder | None:
        """Local folder of copies, for object stores."""
        ...


def open_blobs(address: str, *, cache: Path | None = None, create: bool = True) -> Blobs:
    """Open the storage at an address: a folder, ``file://…`` or ``s3://bucket/prefix`` (also gs, az, memory).

    A missing folder is created, unless ``create`` is false.

    Raises
    ------
    BadAddress
        The scheme is unknown, or needs a package that is not installed.
    StoreUnavailable
        The folder cannot be created.
    """
    scheme, colon, _ = address.partition("://")
    if not colon:
        return Folder(Path(address), create=create)
    if scheme == "file":
        return Folder(Path(unquote(urlsplit(address).path)), create=create)
    if scheme not in SCHEMES:
        known = ", ".join(f"{name}://" for name in ("file", *SCHEMES))
        raise BadAddress(f"artifacts are stored in a folder or at {known}, not at '{scheme:.40}://'")
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return Bucket(_object_store(address), Folder(cache or home / "adverb", create=create))


class Folder:
    """Blobs in one folder of a local disk or a shared volume.

    Parameters
    ----------
    root : Path
    create : bool
        Whether to create the folder if it is missing; raises :class:`StoreUnavailable` if it cannot be.
    """

    cache: Folder | None = None

    def __init__(self, root: Path, *, create: bool = True) -> None:
        self.root = root.absolute()
        self._checked: dict[str, tuple[int, int, int]] = {}
        if create:
            with translated("the artifact folder cannot be created"):
                _make(self.root)

    def put(self, source: Path, at: At) -> Blob:
        """Copy a file atomically: temporary name, fsync, rename to its hash, fsync of the folder.

        Raises :class:`ArtifactError` if the source cannot be read, and :class:`StoreUnavailable` if the folder cannot
        be written.
        """
        try:
            file = source.open("rb")
        except OSError as err:
            raise ArtifactError(source, f"cannot be opened: {err.strerror or err}") from err
        with file:
            return self.write(iter(partial(file.read, CHUNK_BYTES), b""), at)

    def write(self, chunks: Iterable[bytes], at: At, *, expected: str | None = None) -> Blob:
        """Write a blob from its bytes; raises :class:`ArtifactDamaged` if their hash is not ``expected``."""
        part = self.root / f".{secrets.token_hex(8)}.tmp"
        digest, size = hashlib.sha256(), 0
        with translated("artifacts cannot be written"):
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
                    raise ArtifactDamaged(str(expected), "is damaged in its storage")
                at("rename")
                part.replace(self._file(sha256))
                at("sync_folder")
                sync_folder(self.root)
            finally:
                part.unlink(missing_ok=True)
        return Blob(f"{sha256}.verb", sha256, size, modified_at_s)

    def has(self, sha256: str) -> bool:
        """Whether a blob exists."""
        with translated("artifacts cannot be read"):
            return self._file(sha256).exists()

    def path(self, sha256: str) -> Path:
        """A blob's file; its hash is checked at the first use in this process, and after changes of the file.

        Raises :class:`ArtifactMissing` if it is missing, :class:`ArtifactDamaged` if it is damaged.
        """
        path = self._file(sha256)
        with translated("artifacts cannot be read"):
            try:
                with path.open("rb") as file:
                    status = os.fstat(file.fileno())
                    stamp = (status.st_ino, status.st_size, status.st_mtime_ns)
                    intact = self._checked.get(sha256) == stamp
                    intact = intact or hashlib.file_digest(file, "sha256").hexdigest() == sha256
            except FileNotFoundError:
                raise ArtifactMissing(sha256, "is missing; it may have been collected") from None
        if not intact:
            raise ArtifactDamaged(sha256, "is damaged")
        self._checked[sha256] = stamp
        return path

    def listing(self) -> list[Blob]:
        """All blobs and temporary files."""
        found = []
        with translated("artifacts cannot be listed"), os.scandir(self.root) as entries:
            for entry in entries:
                match = _NAME.fullmatch(entry.name)
                if match is None and _PART.fullmatch(entry.name) is None:
                    continue
                with suppress(FileNotFoundError):  # removed by another process
                    status = entry.stat()
                    found.append(Blob(entry.name, match and match[1], status.st_size, status.st_mtime))
        return sorted(found, key=lambda blob: blob.name)

    def remove(self, blobs: Iterable[Blob]) -> None:
        """Unlink files; mapped ones stay readable."""
        with translated("artifacts cannot be removed"):
            for blob in blobs:
                (self.root / blob.name).unlink(missing_ok=True)
                self._checked.pop(blob.sha256 or "", None)

    def _file(self, sha256: str) -> Path:
        return self.root / f"{sha256}.verb"


class Bucket:
    """Blobs in an object store, with copies in a local folder.

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
        """Copy a file into the cache, and then atomically into the object store.

        Raises :class:`ArtifactError` if the source cannot be read, and :class:`StoreUnavailable` if the bucket cannot
        be written.
        """
        import obstore

        blob = self._copies.put(source, at)
        at("upload")
        with translated("the bucket cannot be written"):
            obstore.put(self._store, blob.name, self._copies.path(str(blob.sha256)))
        return blob

    def has(self, sha256: str) -> bool:
        """Whether a blob exists in the object store."""
        import obstore

        with translated("the bucket cannot be read"):
            try:
                obstore.head(self._store, f"{sha256}.verb")
            except FileNotFoundError:
                return False
        return True

    def path(self, sha256: str) -> Path:
        """The cached file, fetched if missing or damaged; raises :class:`ArtifactMissing`."""
        import obstore

        with suppress(ArtifactMissing):
            return self._copies.path(sha256)
        with translated("the bucket cannot be read"):
            try:
                chunks = (bytes(chunk) for chunk in obstore.get(self._store, f"{sha256}.verb").stream())
                first = next(chunks, b"")
            except FileNotFoundError:
                raise ArtifactMissing(sha256, "is not in the bucket; it may have been collected") from None
            self._copies.write(chain([first], chunks), lambda step: None, expected=sha256)
        return self._copies.path(sha256)

    def listing(self) -> list[Blob]:
        """All blobs of the object store."""
        import obstore

        found = []
        with translated("the bucket cannot be listed"):
            for row in chain.from_iterable(obstore.list(self._store)):
                match = _NAME.fullmatch(row["path"])
                if match:
                    found.append(Blob(match[0], match[1], row["size"], row["last_modified"].timestamp()))
        return sorted(found, key=lambda blob: blob.name)

    def remove(self, blobs: Iterable[Blob]) -> None:
        """Delete blobs from the object store, not from the cache."""
        import obstore

        with translated("blobs of the bucket cannot be removed"):
            for blob in blobs:
                with suppress(FileNotFoundError):
                    obstore.delete(self._store, blob.name)


def _object_store(address: str) -> ObjectStore:
    """Object store at an address; keys and endpoint come from the environment (``AWS_…``), never from the address."""
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
def translated(problem: str) -> Iterator[None]:
    """Raise failures of disks and networks as :class:`StoreUnavailable`."""
    try:
        yield
    except OSError as err:
        raise StoreUnavailable(f"{problem}: {err.strerror or _line(err)}") from err
    except Exception as err:
        if type(err).__module__.partition(".")[0] != "obstore":  # imported only if it is used
            raise
        raise StoreUnavailable(f"{problem}: {_line(err)}") from err


def _line(err: Exception) -> str:
    return (str(err).strip().splitlines() or [type(err).__name__])[0][:200]


def _make(folder: Path) -> None:
    """Create a folder and those above it, durably: a power failure must not remove it with the artifacts in it."""
    if not folder.is_dir():
        if not folder.parent.exists():
            _make(folder.parent)
        folder.mkdir(exist_ok=True)
        sync_folder(folder.parent)


def sync_folder(folder: Path) -> None:
    """Write a folder's entries to disk, so that they survive a power failure."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
