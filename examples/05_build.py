"""Build a verb from a folder with verb.toml and motion files, save it, load it and evaluate it.

Run: python examples/05_build.py [FOLDER] [FILE]
"""

from __future__ import annotations

import sys
from pathlib import Path

from verbs import Evaluator, build, library, load, save


def main(folder: str = "", file: str = "example.verb") -> None:
    """Build a folder (by default the source of the built-in ``arm3``) and measure the error between its examples."""
    built = build(folder or library.source("arm3"))
    for warning in built.warnings:
        print(f"warning: {warning}")
    save(built.verb, file)
    verb = load(file)
    blend = Evaluator(verb).blend(verb.values.mean(axis=0)[None])
    size_kb = Path(file).stat().st_size / 1e3
    print(f"{verb.name}: {len(verb.examples)} examples, {size_kb:.0f} kB; error {1e3 * blend.error[0]:.1e} mm")


if __name__ == "__main__":
    main(*sys.argv[1:])
