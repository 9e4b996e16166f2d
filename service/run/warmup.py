"""Compile the kernels that serving, building and refining need, once, on two cores.

``python -m service.run.warmup``
"""

from __future__ import annotations

import logging
import subprocess
import sys
from itertools import islice
from pathlib import Path

import structlog

from service.catalog import catalog
from service.stream import packing
from verbs import library, refine
from verbs.authoring.fit import build
from verbs.runtime.characters import Characters
from verbs.runtime.evaluate import Evaluator

__all__ = ["main"]

LONGEST = "inverse"
"""The method whose kernels take as long to compile as all others together."""


def main() -> None:
    """Load and use what there is, once, while another process compiles the longest; both find what the other kept."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    if sys.argv[1:] == [LONGEST]:
        _ask(LONGEST)
        return
    with subprocess.Popen([sys.executable, "-m", "service.run.warmup", LONGEST]):
        packing.warm()
        Characters(Evaluator(library.load("arm3"))).warm()
        _ask("barycentric")
    catalog.load(None)
    for name in ("arm3", "reach"):
        build(Path(library.__file__).parent / name)
    for _ in islice(refine.refine(library.load("arm3")), 2):
        pass


def _ask(method: str) -> None:
    verb = library.load("arm3")
    Evaluator(verb).blend(verb.values[:1], method=method)


if __name__ == "__main__":
    main()
