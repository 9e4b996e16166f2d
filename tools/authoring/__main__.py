"""Regenerate the sources of the built-in verbs: ``python -m tools.authoring [NAME …]``.

Example: ``python -m tools.authoring reach`` writes ``verbs/library/reach/``. Progress goes to stderr.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from tools.authoring import arm3, board, jog, jump, kick, lift, locomotion, mood, punch, reach, walk
from tools.authoring.source import Source, write
from verbs import library

VERBS: dict[str, Callable[[], Source]] = {
    "arm3": arm3.source,
    "board": board.source,
    "jog": jog.source,
    "jump": jump.source,
    "kick": kick.source,
    "lift": lift.source,
    "locomotion": locomotion.source,
    "mood": mood.source,
    "punch": punch.source,
    "reach": reach.source,
    "walk": walk.source,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the named sources, or all of them."""
    parser = argparse.ArgumentParser(prog="python -m tools.authoring", description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"verbs to write: {', '.join(VERBS)} (default: all)")
    parser.add_argument("--out", type=Path, default=Path(library.__file__).parent, help="folder that holds the sources")
    options = parser.parse_args(arguments)
    if unknown := set(options.names) - set(VERBS):
        parser.error(f"unknown verb {', '.join(sorted(unknown))}; known: {', '.join(VERBS)}")
    for name in options.names or VERBS:
        for step in write(VERBS[name](), options.out / name):
            sys.stderr.write(f"{name}: {step}\n")


if __name__ == "__main__":
    main()
