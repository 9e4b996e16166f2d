"""Fuzz one target with Atheris until a number of inputs or seconds; started by ``python -m tests.fuzz``.

Usage: ``python -m tests.fuzz.runner TARGET FAILURES [options of libFuzzer] FOLDER…``. Inputs that break the contract
are written to the folder FAILURES, one for each place in the code, and the search continues.
"""

from __future__ import annotations

import hashlib
import logging
import sys
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

import atheris

from tests.fuzz import bounds
from tests.fuzz.targets import TARGETS

ROOT = Path(__file__).parents[2]


def compiled() -> list[str]:
    """Modules with kernels, which Numba compiles only as they are."""
    paths = [path for package in ("verbs", "service") for path in (ROOT / package).rglob("*.py")]
    found = [path for path in paths if path.parent.name == "kernels" or "\n@kernel" in path.read_text("utf-8")]
    return [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in found]


def main() -> None:
    """Run the target that the command line names."""
    _, name, failures, *options = sys.argv
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("error", RuntimeWarning)  # as in the test suite
    target, found = TARGETS[name], Path(failures)
    with atheris.instrument_imports(include=list(target.measured), exclude=compiled(), enable_loader_override=False):
        opened = target.open()
    with opened as run:
        atheris.Setup([sys.argv[0], *options], _recorded(run, found))
        atheris.Fuzz()


def _recorded(run: Callable[[bytes], None], failures: Path) -> Callable[[bytes], None]:
    """The target; what leaves it is written once for each place in the code."""
    seen: set[str] = set()

    def one(data: bytes) -> None:
        try:
            bounds.run(run, data)
        except Exception as err:
            rows = [(row.filename, row.lineno) for row in traceback.extract_tb(err.__traceback__)[2:]]
            place = "slow" if isinstance(err, bounds.TooSlow) else f"{type(err).__name__} {rows[-4:]}"
            name = hashlib.sha256(place.encode()).hexdigest()[:12]
            if name not in seen:
                seen.add(name)
                (failures / name).write_bytes(data)
                (failures / f"{name}.txt").write_text("".join(traceback.format_exception(err)))

    return one


if __name__ == "__main__":
    main()
