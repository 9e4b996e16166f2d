"""Unpacking of zipped verb sources and clips, with limits on size, number and paths of files; packing of sources."""

from __future__ import annotations

import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from verbs.errors import SourceError
from verbs.io.motion_files import ENDINGS

__all__ = ["MAX_FILES", "MAX_UNPACKED_BYTES", "extract", "is_zip", "pack", "unpack", "unpack_clips"]

MAX_FILES = 4_000
MAX_UNPACKED_BYTES = 512 * 1024 * 1024
MAX_DEPTH = 8

_BLOCK = 1 << 20

_BROKEN = (
    zipfile.BadZipFile,
    zlib.error,  # invalid compressed data
    NotImplementedError,  # raised by zipfile for an unknown compression
    RuntimeError,  # raised by zipfile for an encrypted file
    EOFError,
    OSError,
    ValueError,
)
"""What :mod:`zipfile` raises for archives that it cannot read."""


def is_zip(start: bytes) -> bool:
    """Whether a file that starts so is a zip."""
    return start[:4] in (b"PK\x03\x04", b"PK\x05\x06")


def unpack(archive: Path, folder: Path) -> Path:
    """Unpack a verb source into an empty folder; return the folder that holds its ``verb.toml``.

    Raises
    ------
    SourceError
        The archive is broken, too large, leads out of the folder, or holds no source.
    """
    extract(archive, folder)
    return _root(archive, folder)


def unpack_clips(archive: Path, folder: Path) -> Path:
    """Unpack clips into an empty folder; return the folder in it that holds them, with or without ``verb.toml``.

    Errors are those of :func:`unpack`.
    """
    extract(archive, folder)
    if list(folder.glob("verb.toml")) or list(folder.glob("*/verb.toml")):
        return _root(archive, folder)
    places = sorted({path.parent for path in folder.rglob("*") if path.suffix.lower() in ENDINGS and path.is_file()})
    if not places:
        raise SourceError(archive, f"the archive holds no motion files ({', '.join(ENDINGS)})")
    if len(places) > 1:
        listed = ", ".join(str(path.relative_to(folder)) for path in places[:4])
        raise SourceError(archive, f"the archive has clips in several folders: {listed}; put all into one")
    return places[0]


def pack(folder: Path, archive: Path, names: Iterable[str] | None = None) -> None:
    """Zip files of a folder, by default all, as :func:`extract` reads them; the same bytes for the same files."""
    every = (path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as opened:
        for name in sorted(every if names is None else names):
            row = zipfile.ZipInfo(name)  # its date is constant
            row.compress_type, row.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            with (folder / name).open("rb") as source, opened.open(row, "w") as target:
                shutil.copyfileobj(source, target, _BLOCK)


def extract(archive: Path, folder: Path) -> None:
    """Unpack an archive into an empty folder; raises :class:`SourceError` as :func:`unpack` does."""
    try:
        with zipfile.ZipFile(archive) as opened:
            members = [row for row in opened.infolist() if not row.filename.endswith("/") and not _added(row.filename)]
            _check(archive, members)
            left = MAX_UNPACKED_BYTES
            for row in members:
                left -= _write(opened, row, folder.joinpath(*PurePosixPath(row.filename).parts), left, archive)
    except _BROKEN as err:
        raise SourceError(archive, f"the archive cannot be unpacked: {err}") from err


def _added(name: str) -> bool:
    """Whether an archiver put it in by itself."""
    parts = PurePosixPath(name).parts
    return parts[:1] == ("__MACOSX",) or any(part.startswith("._") or part == ".DS_Store" for part in parts)


def _check(archive: Path, members: list[zipfile.ZipInfo]) -> None:
    if len(members) > MAX_FILES:
        raise SourceError(archive, f"the archive holds {len(members)} files; at most {MAX_FILES} are allowed")
    total = sum(row.file_size for row in members)
    if total > MAX_UNPACKED_BYTES:
        raise SourceError(archive, f"unpacked it would be {total} bytes long; at most {MAX_UNPACKED_BYTES} are allowed")
    for row in members:
        path = PurePosixPath(row.filename)
        inside = not path.is_absolute() and ".." not in path.parts and "\\" not in row.filename
        inside = inside and ":" not in "".join(path.parts[:1])
        if not path.parts:
            raise SourceError(archive, "the archive has a file without a name")
        if not inside or len(path.parts) > MAX_DEPTH:
            raise SourceError(archive, f"the archive's file '{row.filename[:100]}' would lie outside of its folder")
        if stat.S_ISLNK(row.external_attr >> 16):
            raise SourceError(archive, f"the archive's file '{row.filename[:100]}' is a link; put the file itself in")
        if row.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others are unpacked as a whole
            name = row.filename[:100]
            problem = "is compressed by another method than deflate; pack it anew, with the zip program's default"
            raise SourceError(archive, f"the archive's file '{name}' {problem}")


def _write(opened: zipfile.ZipFile, row: zipfile.ZipInfo, path: Path, left: int, archive: Path) -> int:
    """Unpack one file, whatever length its header claims; return how many bytes it had."""
    path.parent.mkdir(parents=True, exist_ok=True)
    count = 0
    with opened.open(row) as source, path.open("xb") as target:
        while block := source.read(_BLOCK):
            count += len(block)
            if count > left:
                raise SourceError(archive, f"unpacked it is longer than {MAX_UNPACKED_BYTES} bytes")
            target.write(block)
    return count


def _root(archive: Path, folder: Path) -> Path:
    found = sorted(folder.glob("verb.toml")) or sorted(folder.glob("*/verb.toml"))
    if len(found) != 1:
        many = ", ".join(str(path.relative_to(folder)) for path in found[:4])
        problem = f"it holds several: {many}" if found else "it holds none, neither at its top nor in its one folder"
        raise SourceError(archive, f"an archive of a verb source has one verb.toml; {problem}")
    return found[0].parent
