"""The process in which uploads are read: ``python -m service.upload.sandbox``, one upload each.

It loads and warms everything first, with time that nobody else wants, says so, and waits for its one job on stdin.
Whatever the upload does to it, the server goes on: memory, time and files are limited, and the answer is one line of
JSON.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

from service.upload.archive import is_zip, unpack
from verbs.errors import VerbError

__all__ = ["main", "work"]

MAX_MEMORY_BYTES = 4 * 1024**3
MAX_CPU_S = 120
MAX_FILE_BYTES = 1024**3

NICE = 10
"""By how much others go before getting ready; the job itself, for which somebody waits, is nobody's inferior."""


def main() -> None:
    """Get ready, then do the job that stdin brings."""
    warming = threading.Thread(target=_warm)  # Linux keeps a priority for each thread
    warming.start()
    warming.join()
    _say({"ready": True})
    line = sys.stdin.readline()
    if not line.strip():
        return  # nobody needs it any more
    job = json.loads(line)
    _limit()
    _say(work(Path(job["upload"]), Path(job["result"])))


def work(upload: Path, result: Path) -> dict[str, Any]:
    """Build or check an upload, and write the verb; what is told of it."""
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
    except VerbError as err:
        return {"error": _without_paths(str(err), upload), "kind": type(err).__name__}
    except MemoryError:
        return {"error": f"it needs more than {MAX_MEMORY_BYTES // 1024**3} GiB of memory", "kind": "MemoryError"}
    except Exception as err:
        return {"error": f"it cannot be read: {type(err).__name__}", "kind": "internal"}


def _built(folder: Path, result: Path) -> dict[str, Any]:
    from verbs.authoring.fit import build
    from verbs.io import artifact

    made = build(folder)
    artifact.save(made.verb, result)
    return {"verb": made.verb.name, "quality": dict(made.verb.quality), "warnings": list(made.warnings)}


def _without_paths(text: str, upload: Path) -> str:
    """A message without the folders of the server, which are nobody's business."""
    parts = []
    for word in text.split(" "):
        at = word.find(str(upload.parent))
        parts.append(word if at < 0 else word[:at] + word[at:].rsplit("/", 1)[-1])
    return " ".join(parts).replace(upload.name, "the upload")


def _warm() -> None:
    """Load what a job needs, kernels too: a job then takes as long as its own work."""
    os.nice(NICE)
    from verbs import library
    from verbs.authoring.fit import build

    for name in library.names()[:2]:
        source = Path(library.__file__).parent / name
        if source.is_dir():
            build(source)


def _limit() -> None:
    for kind, most in (
        (resource.RLIMIT_AS, MAX_MEMORY_BYTES),
        (resource.RLIMIT_CPU, MAX_CPU_S),
        (resource.RLIMIT_FSIZE, MAX_FILE_BYTES),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _say(message: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
