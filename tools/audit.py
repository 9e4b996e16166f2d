"""Known vulnerabilities of the locked packages: pip-audit for Python, npm audit for the page and the TypeScript client.

``python -m tools.audit PIP_AUDIT`` with the path of pip-audit. Exit code 0: nothing is known; 1: something is; 2: an
advisory service did not answer, so nothing is known about some packages.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["Unreachable", "npm_findings", "python_findings"]

PROJECT = Path(__file__).parents[1]
LOCKS = ("requirements.runtime.lock", "requirements.lock")
NPM = ("dashboard", "typescript")


class Unreachable(Exception):
    """The advisory service gave no answer about some packages."""


def python_findings(report: str) -> list[str]:
    """One line for each vulnerability in the JSON of pip-audit; Unreachable if packages were skipped."""
    try:
        rows = json.loads(report)["dependencies"]
    except (ValueError, KeyError):
        raise Unreachable("pip-audit gave no report") from None
    skipped = [row["name"] for row in rows if "skip_reason" in row]
    if skipped or not rows:
        raise Unreachable(f"{len(skipped)} of {len(rows)} packages could not be audited")
    return [f"{row['name']} {row['version']}: {found['id']}" for row in rows for found in row["vulns"]]


def npm_findings(report: str) -> list[str]:
    """One line for each vulnerable package in the JSON of npm audit; Unreachable if it is no report."""
    try:
        rows: Mapping[str, Any] = json.loads(report)["vulnerabilities"]
    except (ValueError, KeyError):
        raise Unreachable("npm audit gave no report") from None
    return [f"{name} {row['range']}: {row['severity']}" for name, row in rows.items()]


def main(pip_audit: str) -> int:
    """Audit each lock file and print one line for each result."""
    npm = shutil.which("npm")
    code = 0
    for name in LOCKS:
        arguments = [
            "--disable-pip",
            "--require-hashes",
            "--format=json",
            "--progress-spinner=off",
            f"--requirement={name}",
        ]
        code = max(code, _audited(name, python_findings, [pip_audit, *arguments], PROJECT))
    if npm is None:
        print("package-lock.json: not audited, npm is not here")
        return max(code, 2)
    for client in NPM:
        lock, folder = f"{client}/package-lock.json", PROJECT / "clients" / client
        code = max(code, _audited(lock, npm_findings, [npm, "audit", "--json"], folder))
    return code


def _audited(name: str, findings: Any, command: list[str], folder: Path) -> int:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    try:
        found = findings(done.stdout)
    except Unreachable as err:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        print(f"{name}: NOT AUDITED, the advisory service gave no answer: {err} ({last[:200]})")
        return 2
    print(f"{name}: " + (f"{len(found)} known vulnerabilities" if found else "no known vulnerability"))
    for line in found:
        print(f"  {line}")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
