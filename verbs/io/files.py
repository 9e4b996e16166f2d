"""Bounded reading and atomic writing of motion files."""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path

from verbs.conventions import MAX_FILE_BYTES
from verbs.errors import MotionFileError

__all__ = ["file_content", "write_atomically"]


def file_content(path: str | Path) -> bytes:
    """Bytes of a regular file of bounded size.

    Raises
    ------
    MotionFileError
        It cannot be read, is not a regular file, or is longer than ``conventions.MAX_FILE_BYTES``.
    """
    try:
        with open(path, "rb", opener=_open_without_waiting) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise MotionFileError(path, None, "a regular file", "a device or a pipe")
            if status.st_size > MAX_FILE_BYTES:
                raise MotionFileError(path, None, f"at most {MAX_FILE_BYTES} bytes", f"{status.st_size} bytes")
            content: bytes = file.read(status.st_size)  # which is allocated at once, also for a smaller file
            return content
    except (OSError, ValueError) as err:  # ValueError: a null byte in the path
        raise MotionFileError(path, None, "a file that can be read", _reason(err)) from err


def write_atomically(path: str | Path, content: bytes) -> None:
    """Write a file in full or not at all.

    Raises
    ------
    MotionFileError
        It cannot be written.
    """
    path = Path(path)
    partial = path.with_name(f".{secrets.token_hex(8)}.tmp")  # same folder: a rename is atomic only there
    try:
        try:
            with open(partial, "xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except (OSError, ValueError) as err:  # ValueError: a null byte in the path
        raise MotionFileError(path, None, "a file that can be written", _reason(err)) from err


def _open_without_waiting(path: str, flags: int) -> int:
    """Open a path without blocking on a pipe that has no writer."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _reason(err: Exception) -> str:
    return getattr(err, "strerror", None) or str(err)
