"""Loading of built-in verbs and files."""

import gc
import shutil
import weakref
from pathlib import Path

import pytest
import structlog

from service.catalog import catalog as catalogs
from verbs import library
from verbs.io import artifact


def test_builtin_verbs_are_served_without_a_folder():
    found = catalogs.load(None)
    assert tuple(found.entries) == library.names()
    assert not found.skipped


def test_a_broken_file_is_reported_and_the_rest_is_served(data_dir):
    with structlog.testing.capture_logs() as lines:
        found = catalogs.load(data_dir)
    assert [row.file for row in found.skipped] == ["cut.verb", "noise.verb"]
    assert "sway" in found.entries
    reported = [line for line in lines if line["log_level"] == "error"]
    assert [line["event"] for line in reported] == ["verb file skipped"] * 2
    assert all(line["problem"] for line in reported)


def test_reports_for_clients_name_no_folders(data_dir):
    assert not any(str(data_dir) in row.problem for row in catalogs.load(data_dir).skipped)


def test_whatever_is_wrong_with_one_file_the_others_are_served(data_dir, monkeypatch):
    load = artifact.load

    def fragile(path):
        if path.name == "noise.verb":
            raise ZeroDivisionError
        return load(path)

    monkeypatch.setattr(catalogs.artifact, "load", fragile)
    found = catalogs.load(data_dir)
    assert "sway" in found.entries
    assert found.skipped[1].problem == "ZeroDivisionError"


def test_a_file_takes_the_place_of_a_builtin_verb_and_says_so(tmp_path):
    artifact.save(library.load("arm3"), tmp_path / "mine.verb")
    with structlog.testing.capture_logs() as lines:
        found = catalogs.load(tmp_path)
    assert found.entry("arm3").path == tmp_path / "mine.verb"
    assert [line["verb"] for line in lines if line["event"] == "built-in verb replaced"] == ["arm3"]


def test_of_two_files_with_one_name_the_first_is_served(tmp_path, data_dir):
    for name in ("b.verb", "a.verb"):
        shutil.copy(data_dir / "sway.verb", tmp_path / name)
    found = catalogs.load(tmp_path)
    assert found.entry("sway").path.name == "a.verb"
    assert [row.file for row in found.skipped] == ["b.verb"]
    assert "a.verb" in found.skipped[0].problem


def test_a_catalog_does_not_change(catalog):
    with pytest.raises(TypeError):
        catalog.entries["other"] = catalog.entry("arm3")


def test_a_replaced_version_is_freed_without_a_collection():
    """Servers collect garbage rarely; cycles would keep every version that was ever served, and its file open."""
    path = Path(library.__file__).with_name("arm3.verb")
    gc.collect()
    gc.disable()
    try:
        entry = catalogs.Entry.of_verb(artifact.load(path), path=path)
        evaluator = weakref.ref(entry.evaluator)
        del entry
        assert evaluator() is None
    finally:
        gc.enable()
