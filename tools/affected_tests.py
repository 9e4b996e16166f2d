"""Print the test files that a change touches: ``python -m tools.affected_tests [BASE]``.

A changed test file is printed itself. For a changed module, the test files that import it or a name of it are printed,
and those named after it (``tests/**/test_<module>.py``). BASE is a commit; by default the point at which the branch
left ``origin/main`` or ``main``, or, on that branch itself, the last commit. Uncommitted changes count.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

__all__ = ["affected", "changed_files", "imported_names"]

ROOT = Path(__file__).parents[1]
_SOURCE_ROOTS = ("clients/python/", "clients/load/", "clients/blender/")
"""Folders that hold packages besides the repository's root."""


def changed_files(base: str | None = None) -> list[str]:
    """Paths that differ from a commit, and new files that git does not ignore."""
    base = base or _branch_point()
    changed = _git("diff", "--name-only", base).splitlines()
    return sorted({*changed, *_git("ls-files", "--others", "--exclude-standard").splitlines()})


def affected(changed: Iterable[str]) -> list[str]:
    """Test files that changed files touch, relative to the repository's root."""
    files = [path for path in changed if path.endswith(".py")]
    found = {path for path in files if Path(path).name.startswith("test_") and (ROOT / path).exists()}
    modules = {_module(path) for path in files if not path.startswith("tests/")}
    names = {f"test_{module.rpartition('.')[2]}.py" for module in modules}
    for test in sorted((ROOT / "tests").rglob("test_*.py")):
        if test.name in names or modules & imported_names(test.read_text(encoding="utf-8")):
            found.add(test.relative_to(ROOT).as_posix())
    return sorted(found)


def imported_names(source: str) -> set[str]:
    """Modules that a source imports; of ``from a import b`` both ``a`` and ``a.b``, for ``b`` may be a module."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def _module(path: str) -> str:
    for root in _SOURCE_ROOTS:
        path = path.removeprefix(root)
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _branch_point() -> str:
    for branch in ("origin/main", "main"):
        if _git("rev-parse", "--verify", "--quiet", branch):
            return _git("merge-base", "HEAD", branch)
    return "HEAD"


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)
    return done.stdout.strip()


if __name__ == "__main__":
    print("\n".join(affected(changed_files(*sys.argv[1:2]))))
