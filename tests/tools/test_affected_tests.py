"""Which tests `make check` runs for a change."""

from tools.affected_tests import affected, changed_files, imported_names


def test_a_changed_test_is_affected():
    assert affected(["tests/tools/test_affected_tests.py"]) == ["tests/tools/test_affected_tests.py"]


def test_a_changed_module_affects_its_own_test_and_those_that_import_it():
    found = affected(["service/http/guard.py"])
    assert "tests/service/http/test_guard.py" in found
    assert "tests/verbs/io/test_bvh.py" not in found
    assert "tests/verbs/io/test_bvh_oracles.py" in affected(["verbs/io/bvh.py"])


def test_a_deleted_test_and_other_files_affect_nothing():
    assert affected(["tests/test_that_was_deleted.py", "README.md"]) == []


def test_both_parts_of_a_from_import_count():
    assert imported_names("from a.b import c\nimport d.e") == {"a.b", "a.b.c", "d.e"}


def test_changes_are_listed_against_a_commit():
    assert isinstance(changed_files("HEAD"), list)
