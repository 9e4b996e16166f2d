"""Drafts in the store: revisions, limits, blobs that live as long as a row refers to them; sources of versions."""

import json
import threading

import pytest

from service.store.drafts import Content
from service.store.records import DraftChanged, InvalidValue, TooManyDrafts, UnknownDraft
from service.store.store import ORPHAN_S

BOUNDS = {"most": 3, "most_bytes": 10**6}
DAY_S = 86400.0


@pytest.fixture
def content(tmp_path):
    """Makes contents whose files hold a text."""

    def make(text, *, built=True, name="punch"):
        files = [tmp_path / f"{kind}-{text}" for kind in ("archive", "motion", "artifact")]
        for path in files:
            path.write_text(path.name * 100)
        return Content(name, 5, 1, json.dumps({"text": text}), files[0], files[1], files[2] if built else None)

    return make


def test_a_draft_is_read_as_it_was_written(store, location, content):
    added = store.drafts.add("d1", content("one"), **BOUNDS)
    again = location.open()
    try:
        assert again.drafts.read("d1") == (added, '{"text": "one"}')
        assert again.drafts.listed() == [added]
        assert (added.revision, added.name, added.clips, added.excluded) == (1, "punch", 5, 1)
        assert again.drafts.path(added.archive).read_text() == "archive-one" * 100
        assert again.drafts.path(added.artifact).read_text() == "artifact-one" * 100
    finally:
        again.close()


def test_a_change_is_the_next_revision_and_may_have_no_verb(store, content):
    first = store.drafts.add("d1", content("one"), **BOUNDS)
    second = store.drafts.change("d1", 1, content("two", built=False, name="kick"))
    assert (second.revision, second.name, second.artifact) == (2, "kick", None)
    assert second.created_at_s == first.created_at_s < second.changed_at_s
    assert store.drafts.read("d1") == (second, '{"text": "two"}')


def test_another_revision_than_expected_changes_nothing(store, content):
    store.drafts.add("d1", content("one"), **BOUNDS)
    store.drafts.change("d1", 1, content("two"))
    with pytest.raises(DraftChanged) as wrong:
        store.drafts.change("d1", 1, content("three"))
    assert (wrong.value.expected, wrong.value.found) == (1, 2)
    with pytest.raises(DraftChanged):
        store.drafts.delete("d1", revision=1)
    assert store.drafts.read("d1")[1] == '{"text": "two"}'


def test_of_two_changes_at_once_one_is_refused(location, store, content):
    store.drafts.add("d1", content("one"), **BOUNDS)
    contents, outcomes, start = [content("a"), content("b")], [], threading.Barrier(2)

    def change(own):
        opened = location.open()
        try:
            start.wait(30.0)
            outcomes.append(opened.drafts.change("d1", 1, own).revision)
        except DraftChanged as err:
            outcomes.append(err.found)
        finally:
            opened.close()

    threads = [threading.Thread(target=change, args=(own,)) for own in contents]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert outcomes == [2, 2]
    assert store.drafts.get("d1").revision == 2


def test_number_and_bytes_are_bounded(store, content):
    first = store.drafts.add("d1", content("one"), **BOUNDS)
    with pytest.raises(TooManyDrafts, match="bytes") as wrong:
        store.drafts.add("d2", content("two"), most=3, most_bytes=2 * first.size_bytes - 1)
    assert wrong.value.limit == 2 * first.size_bytes - 1
    store.drafts.add("d2", content("two"), most=3, most_bytes=2 * first.size_bytes)
    with pytest.raises(TooManyDrafts, match="2 drafts"):
        store.drafts.add("d3", content("three"), most=2, most_bytes=10**6)
    assert [row.id for row in store.drafts.listed()] == ["d2", "d1"]
    store.drafts.delete("d1", revision=1)
    store.drafts.add("d3", content("three"), most=2, most_bytes=10**6)


def test_unknown_drafts_and_invalid_names_are_refused(store, content):
    for call in (store.drafts.get, store.drafts.read, store.drafts.delete):
        with pytest.raises(UnknownDraft):
            call("nope")
    with pytest.raises(UnknownDraft):
        store.drafts.change("nope", 1, content("one"))
    with pytest.raises(InvalidValue):
        store.drafts.add("d1", content("one", name="No Name"), **BOUNDS)
    with pytest.raises(InvalidValue):
        store.drafts.add("", content("one"), **BOUNDS)
    assert store.drafts.listed() == []


def test_blobs_are_collected_when_no_draft_and_no_version_refers_to_them(store, location, content, artifact):
    store.drafts.add("d1", content("one"), **BOUNDS)
    store.drafts.change("d1", 1, content("two"))
    source = content("source").archive
    version = store.publish("punch", artifact("verb"), author="ada", reason="draft", quality={}, source=source)
    assert store.source(version).read_text() == "archive-source" * 100
    later_s = 2.0 * 10**9  # the clock of the store and of the disk are long before
    kept = {"archive-two", "motion-two", "artifact-two", "archive-source"}
    store.collect(now_s=later_s, drafts_s=2.0 * 10**9)
    assert {path.read_text() for path in location.artifacts.iterdir()} == {
        *(name * 100 for name in kept),
        "verb" * 1000,
    }
    removed = store.collect(now_s=later_s, drafts_s=DAY_S)
    assert "draft d1" in removed
    assert {path.read_text() for path in location.artifacts.iterdir()} == {"archive-source" * 100, "verb" * 1000}
    for number in (2, 3):
        store.publish("punch", artifact(f"next {number}"), author="ada", reason="", quality={})
    store.collect(now_s=later_s, keep=1, younger_s=ORPHAN_S)
    assert {path.read_text() for path in location.artifacts.iterdir()} == {"next 3" * 1000}


def test_drafts_that_were_changed_lately_are_kept(store, content, clock):
    store.drafts.add("d1", content("one"), **BOUNDS)
    changed_s = store.drafts.change("d1", 1, content("two")).changed_at_s
    assert store.collect(now_s=changed_s + DAY_S - 1.0, drafts_s=DAY_S) == []
    assert "draft d1" in store.collect(now_s=changed_s + DAY_S + 1.0, drafts_s=DAY_S)


def test_a_refined_version_has_the_source_of_its_parent(store, content, artifact):
    options = {"author": "ada", "reason": "", "quality": {}}
    bare = store.publish("punch", artifact("bare"), **options)
    assert store.source(bare) is None
    first = store.publish("punch", artifact("one"), source=content("one").archive, **options)
    refined = store.publish("punch", artifact("two"), parent=first.number, **options)
    assert refined.source_sha256 is None
    assert store.source(refined) == store.source(first)


def test_the_same_artifact_with_a_source_gets_it_later(store, content, artifact):
    options = {"author": "ada", "reason": "", "quality": {}}
    first = store.publish("punch", artifact("one"), **options)
    again = store.publish("punch", artifact("one"), source=content("one").archive, **options)
    assert again.number == first.number
    assert store.source(store.version("punch", 1)).read_text() == "archive-one" * 100
