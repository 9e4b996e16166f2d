"""Locks, licences and reports of audits."""

import json
import re
from pathlib import Path

import pytest

from tools import audit, licences

PROJECT = Path(__file__).parents[2]
LOCKS = sorted(PROJECT.glob("requirements*.lock"))


@pytest.mark.parametrize("path", LOCKS, ids=lambda path: path.name)
def test_every_locked_package_has_hashes_and_no_address(path):
    text = path.read_text("utf-8")
    packages = re.split(r"^(?=[a-z0-9])", text, flags=re.MULTILINE)[1:]
    assert packages
    for package in packages:
        assert re.match(r"[\w.-]+(\[.+\])?==", package), package
        assert "--hash=sha256:" in package, package
    assert "://" not in text


@pytest.mark.parametrize("client", ["dashboard", "typescript"])
def test_every_npm_package_has_a_hash_and_no_address(client):
    text = (PROJECT / "clients" / client / "package-lock.json").read_text("utf-8")
    rows = {name: row for name, row in json.loads(text)["packages"].items() if name}
    assert rows
    assert all(row["integrity"].startswith("sha512-") for row in rows.values())
    assert "://" not in text


def test_the_list_of_licences_is_current():
    assert licences.PATH.read_text("utf-8") == licences.text(), "run `make licences`"


def test_the_list_has_every_locked_package_and_nothing_else():
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \|$", licences.PATH.read_text("utf-8"), re.MULTILINE)
    listed = {(name, version) for name, version, _ in rows} - {("package", "version"), ("---", "---")}
    page = {(name, version) for name, (version, _) in licences.page_packages().items()}
    assert listed == {*licences.locked(), *page}
    assert len(licences.locked()) > 40


def test_a_package_that_is_not_installed_has_no_licence():
    with pytest.raises(LookupError, match="not installed"):
        licences.licence("there-is-no-such-package")


def python_report(*rows):
    return json.dumps({"dependencies": rows})


def test_a_vulnerable_python_package_is_named():
    clean = {"name": "numpy", "version": "2.4.6", "vulns": []}
    weak = {"name": "h11", "version": "0.1", "vulns": [{"id": "PYSEC-2025-1"}]}
    assert audit.python_findings(python_report(clean)) == []
    assert audit.python_findings(python_report(clean, weak)) == ["h11 0.1: PYSEC-2025-1"]


@pytest.mark.parametrize(
    "report",
    ["", "no JSON", python_report(), python_report({"name": "numpy", "skip_reason": "not found"})],
)
def test_packages_that_were_not_looked_up_are_not_clean(report):
    with pytest.raises(audit.Unreachable):
        audit.python_findings(report)


def test_a_vulnerable_package_of_the_page_is_named():
    assert audit.npm_findings('{"vulnerabilities": {}}') == []
    found = audit.npm_findings('{"vulnerabilities": {"vite": {"range": "<8", "severity": "high"}}}')
    assert found == ["vite <8: high"]
    with pytest.raises(audit.Unreachable):
        audit.npm_findings('{"message": "405 Method Not Allowed"}')
