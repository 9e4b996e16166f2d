"""The process in which one upload is read, built and checked.

Whatever the upload does to it, the server continues: memory, time and files are limited, standard error is discarded,
and the answer is one line of JSON. A supervisor forks it (:func:`run`); a server without one starts it as a program,
``python -m service.upload.sandbox``, which loads everything first, reports that it is ready, and waits for its job on
standard input.
"""

from __future__ import annotations

import errno
import json
import os
import resource
import sys
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.upload.archive import is_zip, unpack
from service.upload.drafting.errors import InvalidDraft
from verbs.errors import VerbError

__all__ = ["MAX_REQUEST_BYTES", "Job", "main", "run", "work"]

Job = Mapping[str, str]
"""Paths: the ``upload``, and the ``result`` to write; or a ``task`` of :mod:`service.upload.drafting.tasks` and its
``folder``."""

MAX_REQUEST_BYTES = 65_536
"""Longest message with which a server sends a job to its parent."""

MAX_MEMORY_BYTES = 4 * 1024**3
"""Address space for the job, beside what is mapped when it starts."""

MAX_CPU_S = 120
MAX_FILE_BYTES = 1024**3

_HAS_PROC = sys.platform == "linux"

FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO})
"""Errors of the server's disk, which are no fault of the upload."""

NICE = 10
"""By how much the priority is lower while a program loads; the job itself runs at the server's priority."""


def main() -> None:
    """Load everything, then do the job that standard input brings."""
    warming = threading.Thread(target=_warm)  # Linux keeps a priority for each thread
    warming.start()
    warming.join()
    _write(sys.stdout.fileno(), {"ready": True})
    line = sys.stdin.readline()
    if not line.strip():
        return  # the server ended
    job = json.loads(line)
    _limit()
    _write(sys.stdout.fileno(), _done(job))


def run(job: Job, to: int) -> None:
    """Do a job in a process that was forked for it, and write the answer to a file descriptor."""
    null = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(null, number)
    os.close(null)
    _limit()
    _write(to, _done(job))


def _done(job: Job) -> dict[str, Any]:
    """The answer to a job of either kind."""
    if "task" not in job:
        return work(Path(job["upload"]), Path(job["result"]))
    from service.upload.drafting import tasks

    folder = Path(job["folder"])
    try:
        return tasks.perform(job["task"], folder)
    except Exception as err:
        return _failed(err, folder / "upload")


def work(upload: Path, result: Path) -> dict[str, Any]:
    """Build or check an upload, and write the verb; return the answer."""
    from verbs.io import artifact
    from verbs.runtime.evaluate import Evaluator

    try:
        with upload.open("rb") as file:
            start = file.read(4)
        if is_zip(start):
            with tempfile.TemporaryDirectory(dir=upload.parent) as folder:
                return _built(unpack(upload, Path(folder)), result)
        verb = artifact.load(upload)
        Evaluator(verb).warm()  # what cannot be evaluated is not served
        result.hardlink_to(upload)
        return {"verb": verb.name, "quality": dict(verb.quality), "warnings": []}
    except Exception as err:
        return _failed(err, upload)


def _failed(err: Exception, upload: Path) -> dict[str, Any]:
    """The answer that stands for an error."""
    cause = err if isinstance(err, OSError) else err.__cause__
    if isinstance(cause, OSError) and cause.errno in FULL:
        return {"error": f"uploads cannot be built: {cause.strerror}", "kind": "storage"}
    if isinstance(err, VerbError):
        more = {"errors": err.errors} if isinstance(err, InvalidDraft) else {}
        return {"error": _without_paths(str(err), upload), "kind": type(err).__name__, **more}
    if isinstance(err, MemoryError):
        return {"error": f"it needs more than {MAX_MEMORY_BYTES // 1024**3} GiB of memory", "kind": "MemoryError"}
    return {"error": f"it cannot be read: {type(err).__name__}", "kind": "internal"}


def _built(folder: Path, result: Path) -> dict[str, Any]:
    from verbs.authoring.fit import build
    from verbs.io import artifact

    made = build(folder)
    artifact.save(made.verb, result)
    return {"verb": made.verb.name, "quality": dict(made.verb.quality), "warnings": list(made.warnings)}


def _without_paths(text: str, upload: Path) -> str:
    """A message without the folders of the server."""
    parts = []
    for word in text.split(" "):
        at = word.find(str(upload.parent))
        parts.append(word if at < 0 else word[:at] + word[at:].rsplit("/", 1)[-1])
    return " ".join(parts).replace(upload.name, "the upload")


def _warm() -> None:
    """Load what a job needs, kernels too."""
    os.nice(NICE)
    from verbs import library
    from verbs.authoring.fit import build

    for name in library.names()[:2]:
        source = Path(library.__file__).parent / name
        if source.is_dir():
            build(source)


def _limit() -> None:
    """Limit this process; memory in addition to what a fork has in common with its parent."""
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() if _HAS_PROC else 0
    for kind, most in (
        (resource.RLIMIT_AS, mapped + MAX_MEMORY_BYTES),
        (resource.RLIMIT_CPU, MAX_CPU_S),
        (resource.RLIMIT_FSIZE, MAX_FILE_BYTES),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _write(to: int, message: Mapping[str, Any]) -> None:
    rest = json.dumps(message).encode() + b"\n"
    while rest:
        rest = rest[os.write(to, rest) :]


if __name__ == "__main__":
    main()
