"""Profiles of the load tester."""

import re
from dataclasses import fields
from pathlib import Path

import pytest
from adverb_load.profile import Profile, ProfileError, Requests, Streams, built_in, parse, read

GUIDE = Path(__file__).resolve().parents[3] / "docs" / "load.md"


def test_built_in_profiles():
    assert list(built_in()) == ["arena", "crowd", "dashboard"]
    for name in built_in():
        found = read(name)
        assert found.name == name
        assert found.description.endswith(".")
        assert found.streams
        assert found.requests
    assert read("crowd").streams[0].channels >= 500
    assert any(row.slow > 0 for row in read("dashboard").streams)


def test_a_file(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('duration_s = 3\n[[streams]]\nverbs = "kick"\n[[requests]]\nrate = 5\n[[requests]]\nrate = 15\n')
    found = read(str(file))
    assert (found.name, found.duration_s) == ("mine", 3.0)
    assert [row.name for row in found.requests] == ["requests-1", "requests-2"]
    assert found.streams[0].verbs == ("kick",)
    assert [row.rate for row in found.at_rate(100.0).requests] == [25.0, 75.0]
    assert found.scaled(0.01).streams[0].sockets == 1
    assert found.scaled(2.0).requests[0].rate == 10.0
    assert parse('[[streams]]\nname = "a"', "x").streams[0] == Streams("a")


@pytest.mark.parametrize(("text", "problem"), [
    ("", "no [[streams]] and no [[requests]]"),
    ("a = [", "not TOML"),
    ("[[streams]]\nsocket = 3", "streams[0]: unknown key 'socket'; known: name, verbs, sockets"),
    ("[[streams]]\nsockets = 0", "'sockets' must be an integer from 1 to 20000, not 0"),
    ("[[streams]]\nsockets = 1.5", "'sockets' must be an integer"),
    ("[[streams]]\nslow = nan", "'slow' must be a number from 0 to 1"),
    ("[[streams]]\nsockets = true", "'sockets' must be an integer"),
    ('[[streams]]\nencoding = "q16"', "'encoding' is 'q16'; expected f32, q48, q32, weights"),
    ("[[streams]]\nverbs = []", "'verbs' must be a name or a list of names"),
    ("[[streams]]\nevents = 1", "'events' must be a true or false"),
    ("[streams]\nsockets = 1", "'streams' must be tables"),
    ("[[requests]]\nroute = 3", "'route' must be a text"),
    ('[[requests]]\nname = "a"\n[[streams]]\nname = "a"', "names of groups must differ"),
])  # fmt: skip
def test_what_is_wrong_is_named(text, problem):
    with pytest.raises(ProfileError, match=re.escape(problem)):
        parse(text, "x")


def test_an_unknown_name_lists_the_known_ones(tmp_path):
    with pytest.raises(ProfileError, match="built in: arena, crowd, dashboard"):
        read("arenas")
    with pytest.raises(ProfileError, match="No such file"):
        read(str(tmp_path / "none.toml"))


def test_a_rate_needs_requests():
    with pytest.raises(ProfileError, match="no requests"):
        parse("[[streams]]", "x").at_rate(3.0)


def test_every_key_is_documented():
    text = GUIDE.read_text()
    for kind in (Profile, Streams, Requests):
        for row in fields(kind):
            assert f"`{row.name}`" in text or f"`[[{row.name}]]`" in text, row.name
