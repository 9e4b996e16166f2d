"""CONTRIBUTING.md names files; they exist, and every package has a place in it."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
NAMED = sorted({name for name in re.findall(r"`([\w./-]+/[\w./-]+)`", TEXT) if not name.startswith(("..", ".cache"))})


@pytest.mark.parametrize("name", NAMED)
def test_each_named_file_exists(name):
    assert (ROOT / name).exists()


def test_each_package_has_a_place():
    for root in ("verbs", "service"):
        parts = [path for path in (ROOT / root).iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()]
        names = {path.relative_to(ROOT).as_posix() for path in parts if path.name != "__init__.py"}
        assert names - set(NAMED) <= {"verbs/conventions.py", "verbs/errors.py"}


@pytest.mark.parametrize("thing", ["method", "route", "problem code", "stream message", "metric", "setting", "verb"])
def test_a_reader_finds_where_to_add(thing):
    rows = [line for line in TEXT.split("## How to add")[1].split("##")[0].splitlines() if line.startswith("| a ")]
    (row,) = [line for line in rows if re.match(rf"\| a [\w -]*{thing} \|", line)]
    assert re.search(r"`[\w./]+/[\w./]+`", row)
