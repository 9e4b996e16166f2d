"""docs/reliability.md has a row for each promise, and its tests exist."""

from tools import reliability
from tools.reliability import FILE, PROJECT, Promise, Results


def test_each_test_exists():
    for promise in reliability.promises():
        assert promise.tests or promise.figure
        for test in promise.tests:
            assert (PROJECT / "tests" / test).is_file(), test


def test_each_promise_has_its_row():
    text = FILE.read_text(encoding="utf-8")
    assert [promise.text for promise in reliability.promises() if f"| {promise.text} |" not in text] == []
    assert "**fails**" not in text


def test_recorded_runs_are_read():
    found = Results()
    reliability.read_runs(found)
    assert len(found.fuzz) >= 16
    assert {"versions", "refinements", "streams", "answers", "memory", "files"} <= found.chaos.keys()


def test_a_row_has_counts_and_recorded_properties():
    found = Results(properties={"a/test_b.py": ["7 sockets"]}, chaos={"files": "9 open"})
    found.passed["a/test_b.py"], found.skipped["a/test_b.py"] = 3, 1
    row = reliability.row_of(Promise("It holds.", ("a/test_b.py",), reliability.of_chaos("files"), "`make it`"), found)
    assert row == "| It holds. | `tests/a/test_b.py`, `make it` | 9 open; 3 tests pass, 1 skipped; 7 sockets |"
