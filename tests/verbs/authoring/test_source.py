import re
import shutil

import numpy as np
import pytest

from tests.verbs.gltf_files import Gltf
from tests.verbs.sources import ANGLES, SKELETON, arm_motion, arm_source, example_row, hand, write_source
from verbs.authoring.fit import build
from verbs.authoring.source import read
from verbs.errors import IllPosedVerb, SkeletonMismatch, SourceError, VerbError
from verbs.io import artifact, bvh, npz
from verbs.skeleton import Skeleton


def edit(folder, pattern, replacement):
    path = folder / "verb.toml"
    text, count = re.subn(pattern, replacement, path.read_text(), count=1, flags=re.DOTALL)
    assert count == 1
    path.write_text(text)
    return folder


@pytest.fixture
def source(tmp_path):
    return arm_source(tmp_path / "arm")


def test_unknown_keys_are_kept_as_provenance(source):
    edit(source, 'name = "arm"', 'name = "arm"\nactor = "someone"')
    assert read(source).provenance == {"actor": "someone"}


def test_dates_of_unknown_keys_are_kept_as_text(source, tmp_path):
    edit(source, 'name = "arm"', 'name = "arm"\ncaptured = {day = 2020-01-02, at = [10:30:00]}')
    artifact.save(build(source).verb, tmp_path / "arm.verb")
    kept = artifact.load(tmp_path / "arm.verb").provenance["source"]
    assert kept == {"captured": {"day": "2020-01-02", "at": ["10:30:00"]}}


@pytest.mark.parametrize(
    ("pattern", "replacement", "warning"),
    [
        ('name = "arm"', 'name = "arm"\nlopping = true', "unknown key 'lopping'; did you mean 'looping'?"),
        ('name = "arm"', 'name = "arm"\nDescription = "a"', "unknown key 'Description'; did you mean 'description'?"),
        ('unit = "m"', 'unit = "m"\nstlye = true', "unknown key 'stlye' in [[adverb]]; did you mean 'style'?"),
        (
            'file = "a.bvh"',
            'file = "a.bvh"\nkeytime = []',
            "unknown key 'keytime' in [[example]]; did you mean 'keytimes'?",
        ),
        (
            'name = "arm"',
            'name = "arm"\nunits = {lenght = "m"}',
            "unknown key 'lenght' in [units]; did you mean 'length'?",
        ),
    ],
)
def test_a_misspelled_key_is_named_with_the_nearest_known_one(source, pattern, replacement, warning):
    assert warning in build(edit(source, pattern, replacement)).warnings


def test_a_misspelled_key_stands_beside_the_error_that_it_causes(source):
    with pytest.raises(SourceError, match="'keytime_names' is missing; unknown key 'keytime_name'; did you mean"):
        read(edit(source, "keytime_names", "keytime_name"))


@pytest.mark.parametrize("name", ["jump", "kick", "locomotion", "punch", "reach", "reach_left"])
def test_keys_of_captured_sources_are_no_misspellings(mocap, name):
    assert read(mocap / name).warnings == ()


def test_a_missing_folder_is_an_error_that_describes_a_source(tmp_path):
    with pytest.raises(SourceError, match="folder with a verb.toml"):
        read(tmp_path / "nowhere")


def test_a_file_in_place_of_a_folder_is_refused(source):
    with pytest.raises(SourceError, match="name the folder"):
        read(source / "verb.toml")


@pytest.mark.parametrize("text", ["name = ", "\x00", "a = 1\na = 2", "[[[", "x = " + "[" * 5000])
def test_broken_toml_is_a_source_error(tmp_path, text):
    (tmp_path / "verb.toml").write_text(text)
    with pytest.raises(SourceError, match="not valid TOML"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("pattern", "replacement", "message"),
    [
        ('name = "arm"', "", "'name' is missing"),
        ('name = "arm"', 'name = "../arm"', "must be lower-case"),
        ('name = "arm"', "name = 7", "'name' must be a string, not 7"),
        ("effector_keytime_index = 1", "effector_keytime_index = 3", "keytimes are 0 to 2"),
        ("effector_keytime_index = 1", "effector_keytime_index = true", "must be an integer"),
        ('"joint_position"', '"elbow"', "must be one of none, joint_position, jump, root_velocity"),
        ('keytime_names = .*?\n', "", "'keytime_names' is missing"),
        ('"start", "reach", "end"', '"start", "start", "end"', "repeats a name: start"),
        ('"start", "reach", "end"', '"start"', "2 to 64 names"),
        ('"x"', '"y"', "two adverbs have the same name"),
        ('"x"', '"1x"', "letters, digits"),
        (r"adverb_values = \[", "adverb_values = [nan, ", "example 'a'.*3 numbers, but there are 2 adverbs"),
        (r"adverb_values = \[[^,]*", "adverb_values = [nan", "example 'a'.*holds nan; numbers must be finite"),
        (r"adverb_values = \[[^,]*", "adverb_values = [1e30", r"'a'.*holds 1e\+30; .* 1,000,000,000 at most"),
        (r"adverb_values = \[[^,]*", "adverb_values = [" + "9" * 400, "does not fit into 64 bits"),
        (r"keytimes = \[0.0, 0.5, 1.0\]", "keytimes = [0.0, 0.5, 1e30]", r"'a'.*'keytimes' holds 1e\+30"),
        (r"adverb_values = \[[^,]*", "adverb_values = [" + "9" * 5000, "not valid TOML.*digits"),
        (r"adverb_values = \[[^,]*", 'adverb_values = ["1"', "example 'a'.*list of numbers"),
        (r"keytimes = \[0.0, 0.5, 1.0\]", "keytimes = [0.0, 1.0]", "'a'.*2 numbers, but there are 3 keytime names"),
        (r"keytimes = \[0.0, 0.5", "keytimes = [0.5, 0.2", "example 'a'.*'reach' .0.2 s. must come after 'start'"),
        ('file = "a.bvh"', 'file = "../a.bvh"', "own folder"),
        ('file = "a.bvh"', "", "own folder"),
        ('file = "a.bvh"', r'file = "a\\u0000.bvh"', "own folder"),
        ('file = "a.bvh"', f'file = "{"a" * 256}"', "own folder"),
        ('name = "arm"', 'name = "arm"\nsamples = 0x' + "f" * 5000, "does not fit into 64 bits"),
        ('name = "arm"', 'name = "arm"\nactor = [{age = 0x' + "f" * 5000 + "}]", "does not fit into 64 bits"),
        ('name = "arm"', 'name = "arm"\nactor = {height = nan}', "'actor' holds nan"),
        ('name = "arm"', 'name = "arm"\nactor = ' + "[" * 40 + "]" * 40, "more than 32 deep"),
        ('name = "arm"', "name" + ".a" * 30_000 + " = 1", "a key has more than 32 parts"),
        ('name = "arm"', "name" + ". 'a b'" * 40 + " = 1", "a key has more than 32 parts"),
        ('file = "a.bvh"', 'file = "b.bvh"', "example 'b'.*two examples have the same file name"),
        ('name = "arm"', 'name = "arm"\nup_axis = "+Z"', r"up_axis is '\+Z' and forward_axis '\+Z'"),
        ('name = "arm"', 'name = "arm"\nup_axis = "up"', r"up_axis is 'up'; it must be one of \+X, \+Y, \+Z, -X"),
        ('name = "arm"', 'name = "arm"\nunits = {length = "furlong"}', "must be one of m, dm, cm"),
        ('name = "arm"', 'name = "arm"\nsimplices = [[0, 1, 9]]', "3 different example indices below 5"),
        ('name = "arm"', 'name = "arm"\ngoal = {origin = [0, 0, 0], axes = [[1, 0, 0]]}', "for each of 2"),
    ],
)  # fmt: skip
def test_a_wrong_key_is_named_with_the_way_out(source, pattern, replacement, message):
    with pytest.raises(SourceError, match=message):
        read(edit(source, pattern, replacement))


def test_one_example_is_too_few(tmp_path):
    with pytest.raises(SourceError, match="blends at least two: add motions"):
        build(arm_source(tmp_path, angles={"a": (0.2, 0.4)}))


def test_a_missing_motion_names_the_example(source):
    (source / "c.bvh").unlink()
    with pytest.raises(SourceError, match="example 'c'.*'c.bvh' does not exist"):
        build(source)


def test_a_broken_motion_names_the_example_and_the_line(source):
    path = source / "c.bvh"
    path.write_text(path.read_text()[:-30])
    with pytest.raises(SourceError, match=r"example 'c'.*c.bvh:\d+: expected"):
        build(source)


def test_a_motion_with_nan_names_the_example(source):
    path = source / "b.bvh"
    head, _, body = path.read_text().partition("Frame Time: ")
    rate, _, rows = body.partition("\n")
    path.write_text(f"{head}Frame Time: {rate}\nnan {rows.partition(' ')[2]}")
    with pytest.raises(SourceError, match="example 'b'.*nan"):
        build(source)


def test_keytimes_past_the_end_name_the_example_and_both_times(source):
    edit(source, r"keytimes = \[0.0, 0.5, 1.0\]", "keytimes = [0.0, 0.5, 1.1]")
    with pytest.raises(SourceError, match="example 'a'.*'end' is 1.1 s, but the motion lasts from 0 to 1.0"):
        build(source)


def test_examples_with_equal_adverbs_are_both_named(tmp_path):
    source = arm_source(tmp_path, angles=ANGLES | {"twin": ANGLES["b"]})
    with pytest.raises(IllPosedVerb, match="'b' and 'twin' have the same adverbs"):
        build(source)


def test_collinear_examples_name_the_adverbs_and_the_way_out(tmp_path):
    angles = {name: (0.0, s) for name, s in zip("abcde", [0.1, 0.4, 0.7, 1.0, 1.3], strict=True)}
    rows = [example_row(name, [0, 0.5, 1], [s, 2 * s]) for name, (_, s) in angles.items()]
    motions = {name: arm_motion(*pair) for name, pair in angles.items()}
    with pytest.raises(
        IllPosedVerb, match="one line of the 2-dimensional.*x and y change together.*add examples off it"
    ):
        build(write_source(tmp_path, motions, rows))


def test_an_adverb_that_never_changes_is_named(tmp_path):
    motions = {name: arm_motion(*pair) for name, pair in ANGLES.items()}
    rows = [example_row(name, [0, 0.5, 1], [pair[0], 3.0]) for name, pair in ANGLES.items()]
    with pytest.raises(IllPosedVerb, match="adverb 'y' has the same value in all 5"):
        build(write_source(tmp_path, motions, rows))


def test_differing_joints_are_named(source):
    other = Skeleton(("Upper", "Lower", "Fist"), np.array([-1, 0, 1]), np.eye(3) * [[0], [0.5], [0.4]])
    write_source(source, {"d": arm_motion(1.0, 1.3, skeleton=other)}, [], head=(source / "verb.toml").read_text())
    with pytest.raises(SkeletonMismatch, match="example 'd'.*differs from that of 'a'.*lacks Hand; adds Fist"):
        build(source)


def test_differing_bone_lengths_are_named(source):
    longer = Skeleton(("Upper", "Lower", "Hand"), np.array([-1, 0, 1]), np.array([[0, 0, 0], [0.6, 0, 0], [0.4, 0, 0]]))
    write_source(source, {"d": arm_motion(1.0, 1.3, skeleton=longer)}, [], head=(source / "verb.toml").read_text())
    with pytest.raises(SkeletonMismatch, match="example 'd'.*'Lower' at an offset that differs by 100.0 mm"):
        build(source)


def test_an_unknown_effector_lists_the_joints(source):
    with pytest.raises(SourceError, match="unknown joint 'Nose'; known: Upper, Lower, Hand"):
        build(edit(source, 'effector = "Hand"', 'effector = "Nose"'))


def test_a_root_that_no_motion_has_is_refused(source):
    with pytest.raises(SourceError, match="a joint 'Hips' that becomes the root, found Upper, Lower, Hand"):
        build(edit(source, 'name = "arm"', 'name = "arm"\nroot = "Hips"'))


def test_a_stored_adverb_that_is_off_is_a_warning_with_both_numbers(source):
    x = hand(*ANGLES["a"])[0]
    edit(source, re.escape(repr(x)), repr(x + 0.02))
    built = build(source)
    assert any(f"'a': x {x + 0.02:.4f} m (measured {x:.4f} m)" in warning for warning in built.warnings)
    assert built.verb.values[0, 0] == pytest.approx(x, abs=1e-6)


def test_every_error_of_a_random_mutation_is_typed(source):
    rng = np.random.default_rng(5)
    path = source / "verb.toml"
    text = path.read_text()
    for _ in range(150):
        cut = list(text)
        for _ in range(3):
            cut[rng.integers(len(cut))] = rng.choice(list('0[]="x\n-'))
        path.write_text("".join(cut))
        try:
            read(source)
        except VerbError:
            continue


def test_a_source_may_hold_motions_of_every_kind(tmp_path):
    arm_source(tmp_path / "bvh")
    plain = build(tmp_path / "bvh").verb
    text = (tmp_path / "bvh" / "verb.toml").read_text()
    folder = tmp_path / "mixed"
    shutil.copytree(tmp_path / "bvh", folder)
    source = Gltf()
    joints: list[int] = []
    for k, (name, offset) in enumerate(zip(SKELETON.names, SKELETON.offsets.tolist(), strict=True)):
        joints.append(source.node(name, joints[k - 1] if k else None, translation=offset))
    for name in ("c", "d"):
        motion = bvh.read(folder / f"{name}.bvh")
        clip, times = source.animation(name), np.arange(len(motion)) / motion.fps
        for joint in joints:
            source.channel(clip, joint, "rotation", times, motion.rotations[:, joint])
        (folder / f"{name}.bvh").unlink()
        text = text.replace(f'file = "{name}.bvh"', f'file = "two.glb"\nclip = "{name}"')
    source.write(folder / "two.glb")
    npz.write(bvh.read(folder / "e.bvh"), folder / "e.npz")
    (folder / "e.bvh").unlink()
    (folder / "verb.toml").write_text(text.replace("e.bvh", "e.npz"))
    mixed = build(folder).verb
    assert mixed.examples == plain.examples
    np.testing.assert_allclose(mixed.values, plain.values, atol=1e-6)
    np.testing.assert_allclose(mixed.curves, plain.curves, atol=1e-5)


def test_stretch_of_a_joint_is_refused_unless_the_source_allows_it(source):
    path = source / "c.bvh"
    head, _, table = path.read_text().partition("MOTION\n")
    first, _, last = head.rpartition("CHANNELS 3 ")
    lines = table.splitlines()
    rows = []
    for k, line in enumerate(lines[2:]):
        words = line.split()
        rows.append(" ".join([*words[:-3], f"{0.4 + 0.02 * (k == 3):.3f} 0 0", *words[-3:]]))
    hand = f"{first}CHANNELS 6 Xposition Yposition Zposition {last}"
    path.write_text("\n".join([f"{hand}MOTION", *lines[:2], *rows]) + "\n")
    with pytest.raises(SourceError, match="example 'c'.*joint 'Hand' within 5 mm.*allow more with stretch_m"):
        build(source)
    edit(source, 'name = "arm"', 'name = "arm"\nstretch_m = 0.05')
    warning = "1 joint stretches by up to 19.67 mm ('Hand' in example 'c'); mean offsets are kept"
    assert warning in build(source).warnings
    for text in ("-0.1", "nan", '"far"'):
        with pytest.raises(SourceError, match="stretch_m"):
            read(edit(source, "stretch_m = [^\n]*", f"stretch_m = {text}"))


def test_a_clip_that_a_file_lacks_names_the_example(source):
    with pytest.raises(SourceError, match="example 'walk'.*a BVH file holds one motion"):
        build(edit(source, 'file = "c.bvh"', 'file = "c.bvh"\nclip = "walk"'))
