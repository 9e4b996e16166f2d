from __future__ import annotations

import hashlib

import pytest

from service.store.store import BadAddress, Conflict, InvalidValue, Store, UnknownVerb, UnknownVersion
from verbs.errors import ArtifactError

BY_ADA = {"author": "ada", "reason": "a test", "quality": {"error_mean_m": 0.001}}
BY_ADA_ACT = {"author": "ada", "reason": "a test"}


def test_a_published_version_is_current_and_readable(store, artifact):
    file = artifact("one")
    version = store.publish("reach", file, **BY_ADA)
    assert (version.verb, version.number, version.parent) == ("reach", 1, None)
    assert version.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    assert version.size_bytes == file.stat().st_size
    assert store.current() == {"reach": version}
    assert store.versions("reach") == [version]
    assert store.version("reach", 1) == version
    assert store.path(version).read_bytes() == file.read_bytes()
    assert store.path(version).name == f"{version.sha256}.verb"
    assert store.available


def test_a_reopened_store_has_the_same_rows(store, location, artifact):
    version = store.publish("reach", artifact("one"), **BY_ADA)
    other = location.open()
    assert other.current() == {"reach": version}
    assert other.history("reach") == store.history("reach")
    other.close()


def test_numbers_count_per_verb_and_the_newest_is_current(store, artifact):
    for k, (verb, number) in enumerate([("reach", 1), ("punch", 1), ("reach", 2), ("reach", 3)]):
        assert store.publish(verb, artifact(f"{k}"), **BY_ADA).number == number
    assert {name: version.number for name, version in store.current().items()} == {"punch": 1, "reach": 3}
    assert [version.number for version in store.versions("reach")] == [1, 2, 3]


def test_publishing_the_same_bytes_again_returns_the_existing_version(store, artifact):
    first = store.publish("reach", artifact("one"), **BY_ADA)
    assert store.publish("reach", artifact("one"), **BY_ADA, expected=0) == first
    second = store.publish("reach", artifact("two"), **BY_ADA)
    assert store.publish("reach", artifact("one"), **BY_ADA, activate=False) == first
    assert store.current()["reach"] == second
    assert store.publish("reach", artifact("one"), **BY_ADA) == first
    assert store.current()["reach"] == first
    refined = store.publish("reach", artifact("one"), **BY_ADA, parent=2)
    assert (refined.number, refined.sha256) == (3, first.sha256)
    assert [event.kind for event in store.history("reach")] == ["publish", "publish", "activate", "publish"]


def test_a_version_can_be_published_without_being_served(store, artifact):
    store.publish("reach", artifact("one"), **BY_ADA, activate=False)
    assert store.current() == {}
    assert store.history("reach")[0].current is None
    assert store.activate("reach", 1, **BY_ADA_ACT).number == 1
    assert store.current()["reach"].number == 1


def test_rolling_back_and_forward(store, artifact):
    for text in ("one", "two"):
        store.publish("reach", artifact(text), **BY_ADA)
    assert store.activate("reach", 1, **BY_ADA_ACT).number == 1
    assert store.current()["reach"].number == 1
    store.activate("reach", 1, **BY_ADA_ACT)
    store.activate("reach", 2, **BY_ADA_ACT)
    assert [(event.kind, event.number, event.current) for event in store.history("reach")] == [
        ("publish", 1, 1),
        ("publish", 2, 2),
        ("activate", 1, 1),
        ("activate", 2, 2),
    ]


def test_a_deleted_verb_can_be_activated_and_numbers_are_not_reused(store, artifact):
    store.publish("reach", artifact("one"), **BY_ADA)
    store.delete("reach", **BY_ADA_ACT)
    assert store.current() == {}
    assert [version.number for version in store.versions("reach")] == [1]
    with pytest.raises(UnknownVerb, match="unknown verb 'reach'; known: none"):
        store.delete("reach", **BY_ADA_ACT)
    assert store.publish("reach", artifact("two"), **BY_ADA).number == 2
    store.delete("reach", **BY_ADA_ACT)
    assert store.activate("reach", 1, **BY_ADA_ACT).number == 1
    assert store.current()["reach"].number == 1
    kinds = [(event.kind, event.number, event.current) for event in store.history("reach")]
    assert kinds[1] == ("delete", 1, None)
    assert kinds[-1] == ("activate", 1, 1)


def test_history_has_author_reason_and_time(store, artifact):
    store.publish("reach", artifact("one"), author="ada", reason="first", quality={})
    store.publish("reach", artifact("two"), author="bob", reason="better", quality={})
    store.delete("reach", author="eve", reason="spite")
    events = store.history("reach")
    assert [(event.author, event.reason) for event in events] == [("ada", "first"), ("bob", "better"), ("eve", "spite")]
    assert [event.at_s for event in events] == sorted(event.at_s for event in events)
    assert store.history("reach", limit=1) == events[-1:]


def test_expecting_another_version_is_a_conflict_and_changes_nothing(store, artifact):
    with pytest.raises(Conflict, match="no version of verb 'reach' is current, not 4") as caught:
        store.publish("reach", artifact("one"), **BY_ADA, expected=4)
    assert (caught.value.verb, caught.value.expected, caught.value.found) == ("reach", 4, 0)
    store.publish("reach", artifact("one"), **BY_ADA, expected=0)
    store.publish("reach", artifact("two"), **BY_ADA, expected=1)
    with pytest.raises(Conflict, match="version 2 of verb 'reach' is current, not none: read it again"):
        store.publish("reach", artifact("three"), **BY_ADA, expected=0)
    with pytest.raises(Conflict):
        store.publish("reach", artifact("three"), **BY_ADA, expected=1, activate=False)
    with pytest.raises(Conflict):
        store.activate("reach", 1, **BY_ADA_ACT, expected=1)
    with pytest.raises(Conflict):
        store.delete("reach", **BY_ADA_ACT, expected=1)
    assert store.current()["reach"].number == 2
    assert len(store.history("reach")) == len(store.versions("reach")) == 2
    store.activate("reach", 1, **BY_ADA_ACT, expected=2)
    store.activate("reach", 1, **BY_ADA_ACT, expected=2)  # repeated: the version is current already
    store.delete("reach", **BY_ADA_ACT, expected=1)


def test_errors_list_known_verbs_and_versions(store, artifact):
    for ask in (store.versions, store.history, lambda verb: store.version(verb, 1)):
        with pytest.raises(UnknownVerb):
            ask("reach")
    with pytest.raises(UnknownVerb):
        store.activate("reach", 1, **BY_ADA_ACT)
    with pytest.raises(UnknownVersion):
        store.publish("reach", artifact("one"), **BY_ADA, parent=1)
    with pytest.raises(UnknownVerb):
        store.versions("reach")  # what failed left no name behind
    store.publish("reach", artifact("one"), **BY_ADA)
    with pytest.raises(UnknownVerb, match="known: reach") as verb:
        store.versions("punch")
    assert (verb.value.verb, verb.value.known) == ("punch", ("reach",))
    for ask in (lambda: store.version("reach", 7), lambda: store.activate("reach", 7, **BY_ADA_ACT)):
        with pytest.raises(UnknownVersion, match="verb 'reach' has no version 7; known: 1") as version:
            ask()
        assert version.value.known == (1,)


def test_invalid_values_are_refused(store, artifact, tmp_path):
    file = artifact("one")
    for verb in ("", "Reach", "../reach", "x" * 64):
        with pytest.raises(InvalidValue, match="is not a verb name"):
            store.publish(verb, file, **BY_ADA)
    for quality in ({"x": float("nan")}, {"x": object()}, {"x": "y" * 1_100_000}):
        with pytest.raises(InvalidValue, match="'quality'"):
            store.publish("reach", file, author="ada", reason="", quality=quality)
    for who in ("", "a" * 201, "a\0", "a\ud800"):
        with pytest.raises(InvalidValue, match="'author'"):
            store.publish("reach", file, author=who, reason="", quality={})
    with pytest.raises(ArtifactError, match="cannot be opened"):
        store.publish("reach", tmp_path / "none.verb", **BY_ADA)
    assert store.current() == {}


def test_an_artifact_is_stored_once(store, location, artifact):
    one = store.publish("reach", artifact("one"), **BY_ADA)
    two = store.publish("punch", artifact("one"), **BY_ADA)
    assert store.path(one) == store.path(two)
    assert location.files() == {f"{one.sha256}.verb"}


def test_steps_of_publishing_are_reported_in_order(store, artifact):
    from service.store.store import STEPS

    steps = []
    store.publish("reach", artifact("one"), **BY_ADA, at=steps.append)
    assert tuple(steps) == STEPS


@pytest.mark.parametrize(
    ("database", "message"),
    [
        ("mysql://user:secret@host/x", "not 'mysql:…'"),
        ("sqlite:///relative.db", "absolute file"),
        ("sqlite://", "absolute file"),
        ("postgresql://user:secret@host:port/x", "cannot be read"),
    ],
)
def test_bad_database_addresses_are_named_without_secrets(tmp_path, database, message):
    with pytest.raises(BadAddress, match=message) as caught:
        Store.open(database, str(tmp_path))
    assert "secret" not in str(caught.value)


def test_all_names_are_public():
    from service.store import store as module

    assert all(hasattr(module, name) for name in module.__all__)
    assert len(set(module.__all__)) == len(module.__all__)
