"""Print packages, files and imports of the code: ``python -m tools.architecture [--arrows]``.

For each package of ``verbs`` and ``service``: its files, lines, and the packages that it imports. The last line counts
packages, files, imports between files and between packages, levels, and circles among packages.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import grimp

__all__ = ["main", "packages"]

ROOT = Path(__file__).parents[1]
ROOTS = ("verbs", "service")


def packages(graph: grimp.ImportGraph) -> dict[str, set[str]]:
    """Imports between the parts of the roots: sub-packages, and modules that lie directly in a root."""
    found: dict[str, set[str]] = defaultdict(set)
    for module in graph.modules:
        part = _part(module)
        found[part] |= {_part(other) for other in graph.find_modules_directly_imported_by(module)} - {part}
    return dict(found)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tools.architecture", description="Packages, files and imports.")
    parser.add_argument("--arrows", action="store_true", help="list the imports between files too")
    options = parser.parse_args()
    graph = grimp.build_graph(*ROOTS, cache_dir=None)
    parts = packages(graph)
    levels = _levels(parts)
    files: dict[str, list[int]] = defaultdict(list)
    for module in graph.modules:
        if (path := _file(module)) is not None:
            files[_part(module)].append(len(path.read_text(encoding="utf-8").splitlines()))
    for part in sorted(parts, key=lambda name: (ROOTS.index(name.split(".")[0]), -levels[name], name)):
        imports = ", ".join(sorted(parts[part]))
        print(f"{levels[part]:>3}  {part:<28}{len(files[part]):>3} files {sum(files[part]):>6} lines   {imports}")
    arrows = [(a, b) for a in sorted(graph.modules) for b in sorted(graph.find_modules_directly_imported_by(a))]
    if options.arrows:
        print("\n".join(f"{a} -> {b}" for a, b in arrows))
    print(
        f"{len(parts)} packages, {sum(map(len, files.values()))} files, {len(arrows)} imports between files, "
        f"{sum(map(len, parts.values()))} between packages, {max(levels.values())} levels, "
        f"{sum(level == 0 for level in levels.values())} packages in circles"
    )


def _part(module: str) -> str:
    return ".".join(module.split(".")[:2])


def _file(module: str) -> Path | None:
    path = ROOT.joinpath(*module.split("."))
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return next((each for each in candidates if each.exists()), None)


def _levels(parts: dict[str, set[str]]) -> dict[str, int]:
    """One more than the highest level that a package imports; 0 for those in a circle or above one."""
    levels: dict[str, int] = {}
    while True:
        ready = [name for name in parts if name not in levels and parts[name] <= levels.keys()]
        if not ready:
            return levels | {name: 0 for name in parts if name not in levels}
        levels |= {name: 1 + max((levels[other] for other in parts[name]), default=0) for name in ready}


if __name__ == "__main__":
    main()
