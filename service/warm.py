"""Compile the kernels that serving, building and refining need: ``python -m service.warm``."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from service import catalog
from service.stream import packing
from verbs import library, refine
from verbs.build.fit import build

__all__ = ["main"]


def main() -> None:
    """Load and use what there is, once."""
    packing.warm()
    catalog.load(None)
    for name in ("arm3", "reach"):
        build(Path(library.__file__).parent / name)
    for _ in islice(refine.refine(library.load("arm3")), 2):
        pass


if __name__ == "__main__":
    main()
