import numpy as np
import pytest

from tests.verbs import walker
from tests.verbs.sources import arm_source
from verbs.authoring import source
from verbs.authoring.fit import build
from verbs.contacts import PARTS
from verbs.errors import SourceError


def built(folder, more, *, looping=False):
    make = walker.walk if looping else walker.stand
    motions = {"a": make(), "b": make()}
    return build(rewritten(walker.source(folder / "figure", motions, looping=looping), more)).verb


def rewritten(folder, more):
    """The source with tables added at its end."""
    file = folder / "verb.toml"
    file.write_text(file.read_text() + more)
    return folder


def table(joint="LeftFoot", intervals="a = [[0.2, 0.6], [1.0, 2.0]]", part=None):
    return (
        f'\n[[contact]]\njoint = "{joint}"\n'
        + (f'part = "{part}"\n' if part else "")
        + f"intervals = {{ {intervals} }}\n"
    )


def spans(verb, example, joint, part):
    known = verb.contacts
    foot = verb.skeleton.index(joint)
    at = np.flatnonzero((known.feet == foot) & (known.parts == PARTS.index(part)))
    return known.of(example, int(at[0])).tolist()


def test_stated_intervals_replace_those_of_all_parts_in_the_named_examples(tmp_path):
    verb = built(tmp_path, table())
    for part in ("heel", "ball", "toe"):
        assert spans(verb, 0, "LeftFoot", part) == [[0.1, 0.3], [0.5, 1.0]]
        assert spans(verb, 1, "LeftFoot", part) == [[0.0, 1.0]]
        assert spans(verb, 0, "RightFoot", part) == [[0.0, 1.0]]
    values = verb.contacts.values[:, 0, 1]
    assert values[0] == 0.0
    assert values[round(0.2 * verb.intervals)] == values[-1] == 1.0


def test_a_part_alone_is_replaced(tmp_path):
    verb = built(tmp_path, table(part="heel", intervals="a = [], b = [[0, 1]]"))
    assert spans(verb, 0, "LeftFoot", "heel") == []
    assert spans(verb, 1, "LeftFoot", "heel") == [[0.0, 0.5]]
    assert spans(verb, 0, "LeftFoot", "ball") == [[0.0, 1.0]]


def test_any_other_joint_becomes_a_point(tmp_path):
    verb = built(tmp_path, table("Head"))
    assert spans(verb, 0, "Head", "foot") == [[0.1, 0.3], [0.5, 1.0]]
    assert spans(verb, 1, "Head", "foot") == []
    np.testing.assert_allclose(verb.contacts.heights[:, -1], walker.HIP + 0.6, atol=0.02)


def test_a_figure_without_feet_has_the_contacts_that_are_stated(tmp_path):
    folder = rewritten(arm_source(tmp_path / "arm"), table("Hand", "a = [[0.2, 0.4], [0.6, 0.9]]"))
    verb = build(folder).verb
    assert [verb.skeleton.names[foot] for foot in verb.contacts.feet] == ["Hand"]
    assert [len(verb.contacts.of(i, 0)) for i in range(5)] == [2, 0, 0, 0, 0]
    values = verb.contacts.values[:, 0, 0]
    assert (values.min(), values.max()) == (0.0, 1.0)


def test_an_interval_of_a_loop_may_end_before_it_begins(tmp_path):
    verb = built(tmp_path, table(intervals="a = [[0.3, 0.5], [0.8, 0.2]]"), looping=True)
    np.testing.assert_allclose(spans(verb, 0, "LeftFoot", "ball"), [[0.3, 0.5], [0.8, 1.2]])


def test_intervals_are_seconds_of_the_file_and_cut_to_the_keytimes(tmp_path):
    folder = walker.source(tmp_path / "figure", {"a": walker.stand(), "b": walker.stand()})
    text = (folder / "verb.toml").read_text().replace("keytimes = [0.0, 2.0]", "keytimes = [0.5, 1.5]")
    (folder / "verb.toml").write_text(text + table(intervals="a = [[0.0, 0.4], [0.4, 0.75], [1.25, 2.0]]"))
    assert spans(build(folder).verb, 0, "LeftFoot", "ball") == [[0.0, 0.25], [0.75, 1.0]]


def test_contacts_can_be_turned_off(tmp_path):
    folder = walker.source(tmp_path / "figure", {"a": walker.stand(), "b": walker.stand()}, more="contacts = false")
    assert build(folder).verb.contacts is None


def test_tables_are_no_provenance_and_misspelled_keys_are_reported(tmp_path):
    folder = walker.source(tmp_path / "figure", {"a": walker.stand(), "b": walker.stand()})
    rewritten(folder, table().replace("intervals", "intervals = { a = [] }\ninterval"))
    read = source.read(folder)
    assert "contact" not in read.provenance
    assert any("'interval' in [[contact]]; did you mean 'intervals'" in line for line in read.warnings)


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        (table("LeftFeet"), "[[contact]] 0: unknown joint 'LeftFeet'"),
        (table(part="sole"), "part 'sole'; it must be one of heel, ball, toe, foot"),
        (table(part="foot"), "unknown part of 'LeftFoot' 'foot'; known: heel, ball, toe"),
        (table("Head", part="toe"), "unknown part of 'Head' 'toe'; known: foot"),
        (table(intervals="c = [[0, 1]]"), "intervals of 'c', which is no example; examples: a, b"),
        (
            table(intervals="a = [[0.5, 2.5]]"),
            "example 'a': [[contact]] 0 has the interval 0.5 to 2.5 s, but the motion",
        ),
        (table(intervals="a = [[0.5, 0.5]]"), "must end after it begins"),
        (table(intervals="a = [[0.9, 0.5]]"), "must end after it begins"),
        (
            table(intervals="a = [[0.1, 0.5], [0.4, 0.8]]"),
            "example 'a': [[contact]] 0 has intervals that overlap at 0.4 s",
        ),
        (table(intervals="a = [[0.4, 0.8], [0.1, 0.5]]"), "overlap"),
        (table(intervals="a = [0.1, 0.5]"), "[begin, end] pairs"),
        (table(intervals="a = [[0.1, 0.5, 0.6]]"), "[begin, end] pairs"),
        (table(intervals="a = [[-0.1, 0.5]]"), "[begin, end] pairs"),
        (table(intervals="a = [[nan, 0.5]]"), "[begin, end] pairs"),
        (table(intervals="a = [[0.1, inf]]"), "[begin, end] pairs"),
        (table(intervals='a = [["0.1", true]]'), "[begin, end] pairs"),
        (table(intervals="a = 3"), "[begin, end] pairs"),
        (table(intervals=""), "needs intervals"),
        (table(joint=""), "needs the name of a joint"),
        (table() + table(), "[[contact]] 1 states joint 'LeftFoot' a second time"),
        (table() + table(part="heel"), "[[contact]] 1 states joint 'LeftFoot' a second time"),
    ],
)
def test_wrong_tables_are_named(tmp_path, more, problem):
    with pytest.raises(SourceError) as caught:
        built(tmp_path, more)
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    "intervals",
    ["a = [[0.8, 0.2], [0.1, 0.5]]", "a = [[0.8, 0.2], [0.9, 0.1]]", "a = [[0.1, 0.9], [0.8, 0.05]]"],
)
def test_intervals_of_a_loop_may_not_overlap_across_its_seam(tmp_path, intervals):
    with pytest.raises(SourceError, match="overlap"):
        built(tmp_path, table(intervals=intervals), looping=True)


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        ("contacts = 3", "'contacts' must be true or false"),
        ("contact = 3", "[[contact]] tables"),
        ('contacts = false\n[[contact]]\njoint = "LeftFoot"\nintervals = { a = [] }\n', "contacts is false, but"),
    ],
)
def test_wrong_keys_are_named(tmp_path, more, problem):
    with pytest.raises(SourceError) as caught:
        build(walker.source(tmp_path / "figure", {"a": walker.stand(), "b": walker.stand()}, more=more))
    assert problem in str(caught.value)
