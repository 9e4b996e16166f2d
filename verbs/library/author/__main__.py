"""Regenerate the sources of the built-in verbs: ``python -m verbs.library.author [NAME …]``.

Example: ``python -m verbs.library.author reach`` writes ``verbs/library/reach/``. Progress goes to stderr.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from verbs.library.author import arm3, board, reach
from verbs.library.author.source import Source, write

VERBS: dict[str, Callable[[], Source]] = {"arm3": arm3.source, "board": board.source, "reach": reach.source}


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the named sources, or all of them."""
    parser = argparse.ArgumentParser(prog="python -m verbs.library.author", description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"verbs to write: {', '.join(VERBS)} (default: all)")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1], help="folder that holds the sources")
    options = parser.parse_args(arguments)
    if unknown := set(options.names) - set(VERBS):
        parser.error(f"unknown verb {', '.join(sorted(unknown))}; known: {', '.join(VERBS)}")
    for name in options.names or VERBS:
        for step in write(VERBS[name](), options.out / name):
            sys.stderr.write(f"{name}: {step}\n")


if __name__ == "__main__":
    main()
