"""docs/operations.md states every fault that is tested here, and names tests that exist."""

import re
from pathlib import Path

TESTS = Path(__file__).parents[1]
SECTION = (TESTS.parents[1] / "docs" / "operations.md").read_text("utf-8").split("\n## Faults\n")[1].split("\n## ")[0]
ROWS = [[cell.strip() for cell in line.strip("|").split("|")] for line in SECTION.splitlines() if line.startswith("| ")]


def test_each_row_is_complete_and_names_tests_that_exist():
    rows = [row for row in ROWS if row[0] not in ("fault", "---")]
    assert len(rows) > 20
    for row in rows:
        assert len(row) == 4, row
        assert all(row), row
        names = re.findall(r"`([\w/]+\.py)`", row[3])
        assert names, row
        for name in names:
            assert (TESTS / name).is_file(), name


def test_each_file_of_tests_is_named():
    files = {f"faults/{path.name}" for path in Path(__file__).parent.glob("test_*.py")}
    assert {name for name in files if f"`{name}`" not in SECTION} == {f"faults/{Path(__file__).name}"}
