"""Build the artifacts of the built-in verbs from their sources: ``python -m tools.authoring.build``."""

from __future__ import annotations

import sys
from pathlib import Path

from verbs import library
from verbs.authoring.fit import build
from verbs.io import artifact

LIBRARY = Path(library.__file__).parent


def main() -> None:
    """Build every source folder of the library, or those that are named."""
    chosen = sys.argv[1:] or sorted(path.parent.name for path in LIBRARY.glob("*/verb.toml"))
    for name in chosen:
        built = build(LIBRARY / name)
        artifact.save(built.verb, LIBRARY / f"{name}.verb")
        sys.stderr.write("".join(f"{name}: {line}\n" for line in (*built.warnings, "built")))


if __name__ == "__main__":
    main()
