import json
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from tests.verbs import walker
from tests.verbs.sources import arm_source
from verbs.authoring.fit import build
from verbs.errors import ArtifactCorrupt, ArtifactError, ArtifactVersionError, VerbError
from verbs.io import artifact
from verbs.runtime.evaluate import Evaluator

GOLDEN = Path(__file__).parents[2] / "golden" / "arm.v1.verb"
GOLDEN_2 = GOLDEN.with_name("jump.v2.verb")
GOLDEN_CONTACTS = GOLDEN.with_name("contacts.v1.verb")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("artifact")
    artifact.save(build(arm_source(folder / "arm")).verb, folder / "arm.verb")
    return folder / "arm.verb"


def facts_of(path):
    block = path.read_bytes()
    length = int.from_bytes(block[:8], "little")
    return json.loads(json.loads(block[8 : 8 + length])["__metadata__"]["adverb"])


def rewrite(path, target, change=None, arrays=None):
    """The file again with other facts, signed anew, or with other arrays under the old signature."""
    facts, kept = facts_of(path), load_file(path)
    if change:
        facts.pop("sha256")
        change(facts)
        facts["sha256"] = artifact._digest(kept, facts)
    save_file(kept | (arrays or {}), target, metadata={"adverb": json.dumps(facts)})
    return target


def test_a_loaded_verb_gives_the_same_bits(file, tmp_path):
    built = build(arm_source(tmp_path / "arm")).verb
    loaded = artifact.load(file)
    rows, phases = np.random.default_rng(0).uniform(0, 1, (50, 2)), np.linspace(0, 1, 50)
    one, other = (Evaluator(verb).pose(rows, phase=phases) for verb in (built, loaded))
    np.testing.assert_array_equal(one.rotations, other.rotations)
    np.testing.assert_array_equal(one.blend.error, other.blend.error)
    assert dict(loaded.quality) == dict(built.quality)
    assert loaded.adverbs == built.adverbs


def test_the_golden_file_with_contacts_means_the_same():
    """A jump and a figure that stands; never regenerated."""
    verb = artifact.load(GOLDEN_CONTACTS)
    expected = json.loads(GOLDEN_CONTACTS.with_suffix(".json").read_text())
    known = verb.contacts
    assert [verb.skeleton.names[foot] for foot in known.feet] == expected["feet"]
    assert known.parts.tolist() == expected["parts"]
    for p, intervals in enumerate(expected["jump"]):
        np.testing.assert_array_equal(known.of(0, p), intervals)
    assert known.values[round(0.5 * verb.intervals), :, 0].tolist() == expected["middle"] == [0.0, 1.0]


@pytest.fixture(scope="module")
def standing_file(tmp_path_factory):
    """A verb with contacts."""
    folder = tmp_path_factory.mktemp("standing")
    motions = {"jump": walker.jump(), "stand": walker.stand(2.5)}
    artifact.save(build(walker.source(folder / "figure", motions)).verb, folder / "figure.verb")
    return folder / "figure.verb"


def resigned(path, target, arrays=None, *, without=()):
    """The file again with other arrays or without some, signed anew."""
    facts = facts_of(path)
    kept = {key: array for key, array in (load_file(path) | (arrays or {})).items() if key not in without}
    facts.pop("sha256")
    facts["sha256"] = artifact._digest(kept, facts)
    save_file(kept, target, metadata={"adverb": json.dumps(facts)})
    return target


def test_contacts_are_kept_to_the_bit(standing_file, tmp_path):
    loaded = artifact.load(standing_file)
    known = load_file(standing_file)
    for key in artifact._CONTACTS:
        np.testing.assert_array_equal(getattr(loaded.contacts, key), known[f"contacts.{key}"])
    assert not loaded.contacts.values.flags.owndata
    artifact.save(loaded, tmp_path / "again.verb")
    assert (tmp_path / "again.verb").read_bytes() == standing_file.read_bytes()


def test_contacts_do_not_change_the_format_nor_files_without_them(standing_file, file):
    assert facts_of(standing_file)["format"] == facts_of(file)["format"] == 1
    assert not any(name.startswith("contacts.") for name in load_file(file))
    assert artifact.load(GOLDEN).contacts is None
    assert artifact.load(GOLDEN_2).contacts is None


def test_the_same_file_without_contacts_is_a_verb_without_contacts(standing_file, tmp_path):
    names = [f"contacts.{key}" for key in artifact._CONTACTS]
    verb = artifact.load(resigned(standing_file, tmp_path / "bare.verb", without=names))
    assert verb.contacts is None
    rows = verb.values[:1]
    one, other = (Evaluator(v).pose(rows, phase=0.3, plant=False) for v in (verb, artifact.load(standing_file)))
    np.testing.assert_array_equal(one.rotations, other.rotations)


@pytest.mark.parametrize("key", artifact._CONTACTS)
def test_a_file_with_some_arrays_of_contacts_is_refused(standing_file, tmp_path, key):
    with pytest.raises(ArtifactCorrupt, match=f"contacts.{key}"):
        artifact.load(resigned(standing_file, tmp_path / "part.verb", without=[f"contacts.{key}"]))


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("feet", lambda a: a + 1000),
        ("joints", lambda a: a - 1000),
        ("parts", lambda a: a + 3),
        ("offsets", lambda a: a[:, :2]),
        ("offsets", lambda a: a * np.nan),
        ("heights", lambda a: a[:1]),
        ("values", lambda a: a[1:]),
        ("values", lambda a: a - 0.5),
        ("values", lambda a: a.astype(np.float64)[:, :1]),
        ("intervals", lambda a: a + 0.5),
        ("intervals", lambda a: a[:, ::-1]),
        ("owners", lambda a: a + 100),
        ("owners", lambda a: a[::-1]),
    ],
)
def test_contacts_out_of_bounds_are_refused(standing_file, tmp_path, key, change):
    arrays = {f"contacts.{key}": np.ascontiguousarray(change(load_file(standing_file)[f"contacts.{key}"]))}
    with pytest.raises(ArtifactCorrupt):
        artifact.load(resigned(standing_file, tmp_path / "wrong.verb", arrays))


def test_arrays_are_mapped_read_only(file):
    verb = artifact.load(file)
    assert not verb.curves.flags.writeable
    assert not verb.curves.flags.owndata
    with pytest.raises(ValueError, match="read-only"):
        verb.curves[0] = 0


def test_the_file_is_readable_without_our_code(file):
    arrays = load_file(file)
    assert arrays["curves"].dtype == np.float32
    assert facts_of(file)["joints"] == ["Upper", "Lower", "Hand"]


def test_the_golden_file_stays_loadable_and_means_the_same():
    """Written by version 1 of the format; never regenerated."""
    verb = artifact.load(GOLDEN)
    poses = Evaluator(verb).pose({"x": 0.3, "y": 0.6}, phase=0.5)
    assert verb.name == "arm"
    np.testing.assert_allclose(poses.blend.weights.sum(), 1.0, atol=1e-12)
    expected = json.loads(GOLDEN.with_suffix(".json").read_text())
    np.testing.assert_allclose(poses.rotations[0], expected["rotations"], atol=1e-9)
    np.testing.assert_allclose(poses.blend.error[0], expected["error"], atol=1e-9)


def test_the_golden_file_of_format_2_means_the_same():
    """A jump whose distance is in centimetres and whose direction is in degrees; never regenerated."""
    verb = artifact.load(GOLDEN_2)
    expected = json.loads(GOLDEN_2.with_suffix(".json").read_text())
    assert facts_of(GOLDEN_2)["format"] == 2
    assert [adverb.unit for adverb in verb.adverbs] == ["cm", "deg", "m"]
    poses = Evaluator(verb).pose(expected["adverbs"], phase=0.5)
    np.testing.assert_allclose(poses.rotations[0], expected["rotations"], atol=1e-9)
    np.testing.assert_allclose(poses.root[0], expected["root"], atol=1e-9)
    np.testing.assert_allclose(poses.blend.measured[0], list(expected["adverbs"].values()), atol=1e-6)


def test_a_newer_format_says_upgrade(file, tmp_path):
    newer = rewrite(file, tmp_path / "new.verb", lambda facts: facts.update(format=3))
    with pytest.raises(ArtifactVersionError, match="has format 3; this Adverb reads up to 2"):
        artifact.load(newer)


def test_a_changed_array_fails_its_checksum(file, tmp_path):
    with pytest.raises(ArtifactCorrupt, match="checksum"):
        artifact.load(rewrite(file, tmp_path / "x.verb", arrays={"values": load_file(file)["values"] + 1}))


def test_an_array_that_is_not_finite_is_refused(file, tmp_path):
    values = load_file(file)["values"].copy()
    values[0, 0] = np.nan
    with pytest.raises(ArtifactCorrupt, match="'values' holds a number that is not finite"):
        artifact.load(rewrite(file, tmp_path / "x.verb", arrays={"values": values}))


@pytest.mark.parametrize(
    "change",
    [
        {"name": "../../etc"},
        {"joints": ["Upper", "Upper", "Hand"]},
        {"joints": 7},
        {"measure": {"kind": 1, "effector": 99, "keytime": 1}},
        {"measure": {"kind": 99, "effector": 1, "keytime": 1}},
        {"rotation_mode": 5},
        {"examples": ["a"]},
        {"bases": {}},
        {"domain": {"chart": 9, "sharpness": 24}},
        {"format": "one"},
        {"bases": []},
        {"ranges": [[0, 10**400], [0, 1]]},
    ],
)
def test_facts_that_do_not_fit_are_refused(file, tmp_path, change):
    with pytest.raises(ArtifactCorrupt):
        artifact.load(rewrite(file, tmp_path / "x.verb", lambda facts: facts.update(change)))


@pytest.mark.parametrize("value", ["NaN", "-Infinity", '"\\ud800"', "[" * 400 + "]" * 400])
def test_facts_that_have_no_checksum_are_refused(file, tmp_path, value):
    text = json.dumps(facts_of(file) | {"provenance": "HERE"}).replace('"HERE"', value)
    save_file(load_file(file), tmp_path / "x.verb", metadata={"adverb": text})
    with pytest.raises(ArtifactCorrupt):
        artifact.load(tmp_path / "x.verb")


def test_a_missing_file_is_an_artifact_error(tmp_path):
    with pytest.raises(ArtifactError, match="cannot be opened: No such file"):
        artifact.load(tmp_path / "none.verb")


def test_every_cut_of_a_file_is_refused(file, tmp_path):
    block = file.read_bytes()
    for size in [0, 1, 7, 8, 15, 16, 100, 1000, len(block) // 2, len(block) - 1]:
        (tmp_path / "cut.verb").write_bytes(block[:size])
        with pytest.raises(ArtifactCorrupt):
            artifact.load(tmp_path / "cut.verb")


def test_random_damage_is_a_typed_error_or_no_damage(file, tmp_path):
    block, rng = file.read_bytes(), np.random.default_rng(6)
    target, whole, refused = tmp_path / "bad.verb", artifact.load(file), 0
    for _ in range(150):
        damaged = bytearray(block)
        for at in rng.integers(0, len(block), 4):
            damaged[at] = rng.integers(256)
        target.write_bytes(damaged)
        try:
            verb = artifact.load(target)
        except VerbError:
            refused += 1
        else:
            np.testing.assert_array_equal(verb.curves, whole.curves)
            assert verb.adverbs == whole.adverbs
    assert refused > 140


def test_a_failed_write_leaves_nothing(file, tmp_path):
    with pytest.raises(ArtifactError, match="cannot be written"):
        artifact.save(artifact.load(file), tmp_path / "no" / "such" / "x.verb")
    assert list(tmp_path.iterdir()) == []
