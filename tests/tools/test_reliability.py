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


def test_a_check_that_fails_in_the_hour_is_stated_beside_the_last_run():
    document = (
        "# Chaos\n\n## One hour\n\n`hour`\n\n| files | holds | 8 open |\n| answers | **fails** | 18 late |\n\n"
        "## Last run\n\n`last`\n\n| files | holds | 9 open |\n| answers | holds | 7 late |\n"
    )
    last, head = reliability.run_of(document, "Last run")
    found = Results(chaos=last, hour=reliability.run_of(document, "One hour")[0])
    assert head == "`last`"
    assert reliability.of_chaos("files")(found) == "9 open"
    assert reliability.of_chaos("answers")(found) == ("7 late; [one hour](chaos.md#one-hour) fails this check: 18 late")
    assert reliability.run_of(document.replace("One hour", "Other"), "One hour") == ({}, "")


def test_the_document_states_what_fails_in_the_recorded_hour():
    found = Results()
    reliability.read_runs(found)
    text = FILE.read_text(encoding="utf-8")
    failed = [check for check, figure in found.hour.items() if figure.startswith(reliability.FAILS)]
    assert [check for check in failed if reliability.of_chaos(check)(found) not in text] == []
    assert text.count("fails this check") == len(failed)
