import datetime
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.verbs import broken_clips as broken
from tests.verbs.gltf_files import Gltf
from tests.verbs.sources import arm_source, jump_source
from verbs.authoring.fit import build
from verbs.authoring.mirrored_source import mirror_source
from verbs.authoring.source import read
from verbs.authoring.toml_text import toml_dump
from verbs.clips.mirror import mirror
from verbs.errors import SourceError, UnknownName
from verbs.io import bvh

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
PLAIN = st.one_of(st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False), TEXTS)
VALUES = st.recursive(PLAIN, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3))


@given(st.dictionaries(TEXTS, VALUES, max_size=6))
def test_what_is_written_as_toml_comes_back(table):
    assert tomllib.loads(toml_dump(table)) == table


def test_dates_are_written():
    table = {"a": datetime.date(2026, 11, 29), "b": [datetime.datetime(2026, 11, 29, 3, 4, 5)], "c": [{"d": 1}, {}]}
    assert tomllib.loads(toml_dump(table)) == table


def test_a_captured_source_becomes_the_left_one(mocap, tmp_path):
    done = mirror_source(mocap / "reach", tmp_path / "left")
    assert len(done) == 35
    mine, other = read(tmp_path / "left"), read(mocap / "reach_left")
    assert mine.name == "reach_mirrored"
    assert mine.effector == other.effector == "LeftHand"
    assert mine.provenance["mirrored_from"] == "reach"
    for one, two in zip(mine.examples, other.examples, strict=True):
        assert one.values == pytest.approx(two.values)
        assert one.keytimes == two.keytimes
        assert broken.apart_m(bvh.read(one.file), bvh.read(two.file)) < 1e-3
    built = build(tmp_path / "left")
    right = build(mocap / "reach")
    assert len(built.warnings) == len(right.warnings)
    assert np.abs(built.verb.values - right.verb.values * [-1, 1, 1]).max() < 1e-5


@pytest.mark.parametrize(("folder", "signs"), [("jump", [1, -1, 1]), ("locomotion", [1, -1, -1])])
def test_captured_jumps_and_cycles_measure_as_they_state(mocap, tmp_path, folder, signs):
    mirror_source(mocap / folder, tmp_path / "out")
    mine, own = build(tmp_path / "out"), build(mocap / folder)
    assert np.abs(mine.verb.values - own.verb.values * signs).max() < 1e-3
    assert len(mine.warnings) == len(own.warnings)
    if folder == "locomotion":
        assert mine.verb.keytime_names[:2] == ("right stance 1", "left stance 1")


def test_a_source_in_centimetres_stays_one(tmp_path):
    folder = jump_source(tmp_path / "jump")
    for file in folder.glob("*.bvh"):
        bvh.write(bvh.read(file).scaled(100.0), file, decimals=9)
    text = (folder / "verb.toml").read_text()
    (folder / "verb.toml").write_text(text.replace("[[adverb]]", '[units]\nlength = "cm"\n[[adverb]]', 1))
    mirror_source(folder, tmp_path / "out")
    own, mine = build(folder).verb, build(tmp_path / "out").verb
    assert np.abs(mine.values - own.values * [1, -1, 1]).max() < 1e-4
    assert np.allclose(mine.skeleton.offsets, own.skeleton.offsets)


def test_contacts_and_mends_change_sides(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    clips = sorted((broken.LIBRARY / "reach").glob("*.bvh"))[:2]
    rows = ""
    for k, file in enumerate(clips):
        bvh.write(bvh.read(file), folder / f"c{k}.bvh")
        rows += f'[[example]]\nfile = "c{k}.bvh"\nkeytimes = [0.0, 0.5]\nadverb_values = [{k}.0, 0.1]\n'
    (folder / "verb.toml").write_text(
        'name = "a"\nkeytime_names = ["left down", "Right up"]\neffector = "RightHand"\n'
        "[goal]\norigin = [1.0, 2.0, 3.0]\naxes = []\n"
        '[[adverb]]\nname = "m"\nstyle = true\n[[adverb]]\nname = "n"\nstyle = true\n'
        '[[contact]]\njoint = "LeftFoot"\nintervals = { c0 = [[0.0, 0.2]] }\n'
        '[[mend]]\nkind = "spin"\njoint = "RightHand"\n[[mend]]\nkind = "heading"\ndegrees = 30\n' + rows
    )
    mirror_source(folder, tmp_path / "out")
    table = tomllib.loads((tmp_path / "out" / "verb.toml").read_text())
    assert table["keytime_names"] == ["right down", "Left up"]
    assert table["contact"][0] == {"joint": "RightFoot", "intervals": {"c0": [[0.0, 0.2]]}}
    assert [table["mend"][0]["joint"], table["mend"][1]["degrees"]] == ["LeftHand", -30]
    assert table["example"][1]["adverb_values"] == [1.0, 0.1]
    assert table["goal"]["origin"] == [-1.0, 2.0, 3.0]
    back = tmp_path / "back"
    mirror_source(tmp_path / "out", back)
    for k in range(2):
        assert broken.apart_m(bvh.read(back / f"c{k}.bvh"), bvh.read(folder / f"c{k}.bvh")) < 1e-6


def test_a_folder_that_is_not_empty_is_left(tmp_path):
    folder = arm_source(tmp_path / "arm")
    with pytest.raises(SourceError, match="is not empty; name a new folder"):
        mirror_source(folder, folder)
    with pytest.raises(UnknownName, match="unknown joint 'Nose'"):
        mirror_source(folder, tmp_path / "out", {"Nose": "Hand"})


def test_clips_of_one_gltf_file_with_another_axis_up_become_files_of_their_own(tmp_path):
    motion, source = broken.clean(), Gltf()
    upright = source.node("Z_UP", rotation=[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])  # +Z up, -Y forward
    joints: list[int] = []
    for name, parent, offset in zip(
        *(motion.skeleton.names, motion.skeleton.parents, motion.skeleton.offsets), strict=True
    ):
        above = upright if parent < 0 else joints[parent]
        joints.append(source.node(name, above, translation=[float(value) for value in offset]))
    for clip in ("low one", "high/one"):
        rows, times = source.animation(clip), np.arange(len(motion)) / motion.fps
        for k, joint in enumerate(joints):
            source.channel(rows, joint, "rotation", times, motion.rotations[:, k])
        source.channel(rows, joints[0], "translation", times, motion.root)
    folder = tmp_path / "two"
    folder.mkdir()
    source.write(folder / "two.glb")
    end = motion.duration_s
    (folder / "verb.toml").write_text(
        'name = "two"\nkeytime_names = ["start", "end"]\nup_axis = "+Z"\nforward_axis = "-Y"\n'
        '[[adverb]]\nname = "lift"\nstyle = true\n'
        + "".join(
            f'[[example]]\nfile = "two.glb"\nclip = "{clip}"\nkeytimes = [0.0, {end}]\nadverb_values = [{k}.0]\n'
            for k, clip in enumerate(("low one", "high/one"))
        )
    )
    mirror_source(folder, tmp_path / "mirrored")
    mirrored = read(tmp_path / "mirrored")
    assert [example.file.name for example in mirrored.examples] == ["low one.bvh", "high_one.bvh"]
    assert mirrored.axes == ("+Y", "+Z")
    for example in mirrored.examples:
        assert broken.apart_m(bvh.read(example.file), mirror(motion).motion) < 1e-5
