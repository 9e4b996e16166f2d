"""``[[mend]]`` and ``[retarget]`` in a source: read strictly, applied before keytimes are checked, reported."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.verbs import broken_clips as broken
from tests.verbs.sources import arm_source, example_row, write_source
from verbs.authoring.fit import build
from verbs.authoring.source import read
from verbs.cli import app
from verbs.errors import IllPosedVerb, SkeletonMismatch, SourceError
from verbs.io import artifact, bvh
from verbs.motion import Motion

NAMES = ("near", "middle", "far")


def folder_of(path, motions, *, more="", keytimes=None, looping=False, contacts=False):
    """A source of three clips with one style adverb."""
    rows = [
        example_row(name, (keytimes or {}).get(name, [0.0, 0.6 * one.duration_s, one.duration_s]), [float(k)])
        for k, (name, one) in enumerate(motions.items())
    ]
    head = (
        f'name = "mended"\neffector = "RightHand"\ncontacts = {str(contacts).lower()}\n'
        f'looping = {str(looping).lower()}\nkeytime_names = ["start", "reach", "end"]\n'
        '[[adverb]]\nname = "far"\nstyle = true\n'
    )
    return write_source(path, motions, [*rows, more], head)


@pytest.fixture(scope="module")
def clean():
    files = sorted((broken.LIBRARY / "reach").glob("*.bvh"))[:3]
    return dict(zip(NAMES, (bvh.read(file) for file in files), strict=True))


def curves(folder):
    return build(folder).verb.curves


def test_a_mended_clip_gives_the_verb_of_the_clean_one(tmp_path, clean):
    bad = {**clean, "middle": broken.spike(broken.spin(clean["middle"], "RightHand", 40, 60), "Head", 20)}
    plain = build(folder_of(tmp_path / "clean", clean)).verb
    more = '[[mend]]\nkind = "spin"\nexample = "middle"\n[[mend]]\nkind = "spike"\n'
    built = build(folder_of(tmp_path / "bad", bad, more=more))
    assert not built.warnings
    assert [row["kind"] for row in built.verb.provenance["mends"]] == ["spike", "spin"]
    assert {row["example"] for row in built.verb.provenance["mends"]} == {"middle"}
    assert np.abs(plain.curves[:, [0, 2]] - built.verb.curves[:, [0, 2]]).max() < 0.2
    assert np.array_equal(plain.curves[:, 0, :4], built.verb.curves[:, 0, :4])


def test_a_fault_that_is_left_shows_the_table_that_mends_it(tmp_path, clean):
    bad = {**clean, "far": broken.spike(clean["far"], "Head", 20)}
    folder = folder_of(tmp_path / "bad", bad)
    (warning,) = build(folder).warnings
    assert "example 'far': joint 'Head' jumps by 40° at" in warning
    table = warning[warning.index("[[mend]]") :]
    with (folder / "verb.toml").open("a") as file:
        file.write(f"\n{table}\n")
    fixed = build(folder)
    assert not fixed.warnings
    (row,) = fixed.verb.provenance["mends"]
    assert (row["kind"], row["joint"], row["unit"]) == ("spike", "Head", "deg")
    text = (folder / "verb.toml").read_text()
    (folder / "verb.toml").write_text(f"{text}apply = false\n")
    undone = build(folder)
    assert not undone.warnings  # left on purpose
    assert "mends" not in undone.verb.provenance
    assert np.array_equal(undone.verb.curves, curves(folder_of(tmp_path / "again", bad)))


def test_builds_are_deterministic_and_a_source_without_mends_records_none(tmp_path, clean):
    folder = folder_of(tmp_path / "a", clean, more='[[mend]]\nkind = "jitter"\njoint = "Head"\nexample = ["near"]\n')
    for name in ("one", "two"):
        artifact.save(build(folder).verb, tmp_path / name)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    assert "mends" not in build(folder_of(tmp_path / "b", clean)).verb.provenance


def test_idle_ends_shift_keytimes_and_contacts(tmp_path, clean):
    head = 120
    late = broken.idle(clean["near"], head, 60)
    start = head / late.fps
    own = clean["near"].duration_s
    marks = {"near": [0.0, start + 0.55 * own, late.duration_s]}
    more = (
        '[[contact]]\njoint = "RightHand"\n'
        f"intervals = {{ near = [[0.2, 0.4], [{start + 0.3}, {start + 1.0}]] }}\n"
        f'[[mend]]\nkind = "idle"\nexample = "near"\nstart = {start}\nend = {start + own}\n'
    )
    folder = folder_of(tmp_path / "late", {**clean, "near": late}, more=more, keytimes=marks, contacts=True)
    early = more[: more.index("[[mend]]")].replace(f"[0.2, 0.4], [{start + 0.3}, {start + 1.0}]", "[0.3, 1.0]")
    plain = folder_of(tmp_path / "early", clean, more=early, keytimes={"near": [0.0, 0.55 * own, own]}, contacts=True)
    one, other = build(folder).verb, build(plain).verb
    assert np.allclose(one.keytimes, other.keytimes, atol=1e-9)
    assert np.allclose(one.curves, other.curves, atol=1e-5)
    assert np.allclose(one.contacts.intervals, other.contacts.intervals, atol=1e-6)


def test_a_keytime_in_a_trimmed_part_is_an_error(tmp_path, clean):
    more = '[[mend]]\nkind = "idle"\nexample = "near"\nstart = 0.0\nend = 0.5\n'
    with pytest.raises(SourceError, match=r"'near'.*keytime 'reach' .* trims; 0.000 to 0.500 s are left"):
        build(folder_of(tmp_path / "a", clean, more=more))


def test_placement_is_mended(tmp_path, clean):
    bad = {**clean, "near": broken.turned(broken.moved(clean["near"], 1.0, 0.5, 0.0), 90.0)}
    tables = '[[mend]]\nkind = "heading"\ndegrees = 90\nexample = "near"\n[[mend]]\nkind = "start"\n'
    tables += '[[mend]]\nkind = "ground"\nexample = "near"\nheight = 0.5\n'
    fixed = curves(folder_of(tmp_path / "bad", bad, more=tables))
    plain = curves(folder_of(tmp_path / "clean", clean, more='[[mend]]\nkind = "start"\n'))
    assert np.abs(fixed[:, :, :3] - plain[:, :, :3]).max() < 1e-5
    assert "heading" in {row["kind"] for row in build(tmp_path / "bad").verb.provenance["mends"]}


def test_another_body_is_refused_with_the_table_that_retargets_it(tmp_path, clean):
    other = broken.scaled(clean["far"], 0.93)
    folder = folder_of(tmp_path / "two", {**clean, "far": other})
    with pytest.raises(SkeletonMismatch, match=r"example 'far'.*\n\[retarget\]\nskeleton = \"near\"") as refused:
        build(folder)
    text = str(refused.value)
    with (folder / "verb.toml").open("a") as file:
        file.write(text[text.index("[retarget]") : text.index("or leave")])
    verb = build(folder).verb
    rows = verb.provenance["mends"]
    assert {(row["example"], row["kind"]) for row in rows} == {("far", "retarget")}
    (row,) = rows
    offsets = {name: 1000 * np.linalg.norm(offset) * 0.07 for name, offset in
               zip(verb.skeleton.names[1:], verb.skeleton.offsets[1:], strict=True)}  # fmt: skip
    assert row["bones_mm"] == pytest.approx(offsets, abs=0.01)
    longest = max(offsets, key=offsets.get)
    assert f"bones differ from those of 'near': the bone to '{longest}' is" in row["found"]
    assert "and 24 more" in row["found"]
    assert "effector within 0.0 mm" in row["done"]
    (folder / "verb.toml").write_text((folder / "verb.toml").read_text() + "apply = false\n")
    with pytest.raises(SkeletonMismatch):
        build(folder)


def test_other_joints_cannot_be_retargeted(tmp_path, clean):
    skeleton = clean["far"].skeleton
    names = tuple("Nose" if name == "Head" else name for name in skeleton.names)
    from dataclasses import replace

    other = Motion(replace(skeleton, names=names), 60.0, clean["far"].root, clean["far"].rotations)
    folder = folder_of(tmp_path / "two", {**clean, "far": other}, more='[retarget]\nskeleton = "near"\n')
    with pytest.raises(SkeletonMismatch, match="lacks Head; adds Nose; rename its joints"):
        build(folder)


@pytest.mark.parametrize(
    ("joint", "axis", "degrees", "message"),
    [
        ("RightHand", (1.0, 0.0, 0.0), 0.0, 'it spins; unwind it .*\n.*\nkind = "spin"\nexample = "far"'),
        ("Hips", (0.0, 1.0, 0.0), 0.0, "check its keytimes, or leave it out"),
        ("Hips", (0.0, 1.0, 0.0), 90.0, 'faces another way; .*\n.*\nkind = "heading"\nexample = "far"'),
    ],
)
def test_a_joint_that_cannot_be_blended_is_named_with_its_mend(tmp_path, clean, joint, axis, degrees, message):
    bad = {**clean, "far": broken.turned(broken.spin(clean["far"], joint, 30, 60, axis=axis), degrees)}
    with pytest.raises(IllPosedVerb, match=f"rotates joint '{joint}' .* {message}"):
        build(folder_of(tmp_path / "bad", bad))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("mend = 3\n", r"written as \[\[mend\]\] tables"),
        ("[[mend]]\n", r"\[\[mend\]\] 0 has the kind None; it must be one of gap, spike, spin, jitter"),
        ('[[mend]]\nkind = "smooth"\n', "the kind 'smooth'; it must be one of gap"),
        ('[[mend]]\nkind = "idle"\njoint = "a"\n', "unknown key 'joint'; known: kind, example, apply, start, end, sp"),
        ('[[mend]]\nkind = "spin"\nexample = "z"\n', "'z', which is no example; examples: a, b, c, d, e"),
        ('[[mend]]\nkind = "spin"\nexample = []\n', "name of an example, or a list"),
        ('[[mend]]\nkind = "spin"\nexample = [4]\n', "is for 4, which is no example"),
        ('[[mend]]\nkind = "spin"\njoint = 3\n', "the joint 3"),
        ('[[mend]]\nkind = "spin"\nstart = 1\n', "both start and end"),
        ('[[mend]]\nkind = "spin"\nstart = 2\nend = 1\n', "0 ≤ start ≤ end"),
        ('[[mend]]\nkind = "spin"\nstart = 0\nend = 1\n', "needs a joint too"),
        ('[[mend]]\nkind = "jitter"\ncutoff_hz = nan\n', "'cutoff_hz' must be a number"),
        ('[[mend]]\nkind = "jitter"\ncutoff_hz = "8"\n', "'cutoff_hz' must be a number, not '8'"),
        ('[[mend]]\nkind = "spin"\napply = 1\n', "'apply' must be true or false, not 1"),
        ("retarget = 1\n", r"written as a \[retarget\] table"),
        ("[retarget]\n", "needs skeleton.*not None; examples: a, b"),
        ('[retarget]\nskeleton = "a"\nbones = 1\n', "unknown key 'bones'; known: skeleton, example, effector"),
        ('[retarget]\nskeleton = "a"\nfeet = "no"\n', "'feet' must be true or false"),
    ],
)
def test_errors_name_the_key_and_what_is_known(tmp_path, table, message):
    folder = arm_source(tmp_path / "arm")
    text = (folder / "verb.toml").read_text()
    top = table if table.startswith(("mend", "retarget")) else ""
    (folder / "verb.toml").write_text(top + text + ("" if top else table))
    with pytest.raises(SourceError, match=message):
        read(folder)


def test_errors_of_the_clip_name_the_example(tmp_path):
    folder = arm_source(tmp_path / "arm")
    text = (folder / "verb.toml").read_text()
    for table, message in (
        ('kind = "spin"\njoint = "Nose"', r"example 'a': \[\[mend\]\]: unknown joint 'Nose'"),
        ('kind = "heading"', r"example 'a': \[\[mend\]\]: .* give degrees"),
        ('kind = "jitter"\ncutoff_hz = 14', r"example 'd': \[\[mend\]\]: cutoff_hz is 14"),
    ):
        (folder / "verb.toml").write_text(f"{text}[[mend]]\n{table}\n")
        with pytest.raises(SourceError, match=message):
            build(folder)


def test_a_loop_is_not_trimmed(tmp_path, clean):
    with pytest.raises(SourceError, match="is one cycle, which cannot be trimmed"):
        read(folder_of(tmp_path / "a", clean, more='[[mend]]\nkind = "idle"\n', looping=True))


def test_build_prints_the_mends(tmp_path, clean):
    bad = {**clean, "far": broken.spike(clean["far"], "Head", 20)}
    folder = folder_of(tmp_path / "bad", bad, more='[[mend]]\nkind = "spike"\n')
    for arguments in ((), ("--json",)):
        result = CliRunner().invoke(app, ["build", str(folder), "-o", str(tmp_path / "a.verb"), *arguments])
        assert result.exit_code == 0
        if arguments:
            (row,) = json.loads(result.stdout)["mends"]
            assert row["joint"] == "Head"
        else:
            assert "mends" in result.stdout
            assert "interpolated" in result.stdout
