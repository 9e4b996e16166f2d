from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from verbs.conventions import MAX_FRAMES, MAX_JOINTS
from verbs.errors import MotionFileError
from verbs.io import bvh, bvh_reader
from verbs.kernels import quat
from verbs.motion import Motion

# By line: ROOT 2, JOINT Chest 6, JOINT Head 10, Frames: 22, rows 24 to 26.
VALID = (Path(__file__).parent / "valid.bvh").read_text()
ROWS = VALID.splitlines()[23:]


def changed(old: str, new: str) -> str:
    assert VALID.count(old) == 1, f"'{old}' must stand once in the valid file"
    return VALID.replace(old, new)


def assert_same(left: Motion, right: Motion) -> None:
    assert left.skeleton.difference(right.skeleton, tolerance_m=0.0) is None
    assert left.fps == right.fps
    np.testing.assert_array_equal(left.root, right.root)
    np.testing.assert_array_equal(left.rotations, right.rotations)


# --- what is read -----------------------------------------------------------------------------------------


def test_every_part_of_a_file_is_read():
    motion = bvh.parse(VALID)
    assert motion.skeleton.names == ("Hips", "Chest", "Head")
    np.testing.assert_array_equal(motion.skeleton.parents, [-1, 0, 1])
    np.testing.assert_array_equal(motion.skeleton.offsets, [[0, 0, 0], [0, 1, 0], [0, 0.5, 0.1]])
    np.testing.assert_array_equal(motion.skeleton.tip_parents, [2])
    np.testing.assert_array_equal(motion.skeleton.tip_offsets, [[0, 0.2, 0]])
    assert motion.fps == 30.0
    np.testing.assert_array_equal(motion.root, [[0.1, 0.9, 0.2], [0.2, 0.8, 0.3], [0.3, 0.7, 0.4]])


def test_each_joint_turns_in_its_own_order():
    motion = bvh.parse(VALID)
    for joint, (order, degrees) in enumerate([("ZXY", [10, 20, 30]), ("XYZ", [40, 50, 60]), ("YZX", [70, 80, -90])]):
        expected = quat.from_euler(order, np.radians(degrees))
        np.testing.assert_allclose(motion.rotations[0, joint], expected, atol=1e-15)


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("\ufeff" + VALID, id="byte order mark"),
        pytest.param(VALID.replace("\n", "\r\n"), id="windows line ends"),
        pytest.param(VALID.replace("\n", "\r"), id="old mac line ends"),
        pytest.param(VALID.replace("  ", "\t").replace(" ", "\t \t"), id="tabs and more spaces"),
        pytest.param(VALID.replace("\n", "  \t\n\n \n"), id="blank lines and trailing space"),
        pytest.param("\n\n" + VALID + "\n \n\n", id="blank lines around"),
        pytest.param(VALID.rstrip("\n"), id="no newline at the end"),
        pytest.param(re.sub(r"\n *{", " {", VALID), id="brace on the name's line"),
        pytest.param(re.sub(r"Site\s*({.*)\s*(.*)\s*}", r"Site { \2 }", VALID), id="one-line End Site"),
        pytest.param(changed("Frames: 3", "Frames:   3"), id="spaces after Frames:"),
        pytest.param(changed("Frames: 3", "frames :3"), id="no space after Frames:"),
        pytest.param(changed("Frame Time: 0", "FRAME  TIME:0"), id="no space after Frame Time:"),
        pytest.param(changed("End Site", "end  SITE"), id="another case of End Site"),
        pytest.param(VALID.replace("CHANNELS", "Channels").replace("rot", "ROT"), id="another case of channels"),
        pytest.param(VALID.replace("HIER", "Hier").replace("ROOT", "Root"), id="another case of ROOT"),
        pytest.param(VALID.replace("JOINT", "joint").replace("MOT", "mot"), id="another case of JOINT"),
        pytest.param(re.sub(r"( *OFF.*\n)( *CHA.*\n)", r"\2\1", VALID), id="offsets after channels"),
        pytest.param(changed("OFFSET 0 1 0", "OFFSET +0. 1.0e0 -.0"), id="other ways to write numbers"),
    ],
)
def test_layout_does_not_matter(text):
    assert_same(bvh.parse(text), bvh.parse(VALID))


@pytest.mark.parametrize(
    "name", ["mixamorig:Hips", "left-arm.001", "Left Arm", "Bip01 L  Thigh", "腰", "OFFSET", "End Site", "_1"]
)
def test_joint_names_may_hold_almost_anything(name):
    motion = bvh.parse(changed("JOINT Chest", f"JOINT   {name}  "))
    assert motion.skeleton.names == ("Hips", name, "Head")
    assert bvh.parse(bvh.dump(motion)).skeleton.names == motion.skeleton.names


@pytest.mark.parametrize(
    ("channels", "order", "columns"),
    [
        ("3 Zrotation Xrotation Yrotation", "ZXY", [0, 1, 2]),
        ("2 Yrotation Xrotation", "YX", [0, 1]),
        ("1 Xrotation", "X", [0]),
    ],
)
def test_missing_rotation_channels_do_not_turn(channels, order, columns):
    count = len(columns)
    text = changed("3 Yrotation Zrotation Xrotation", channels)
    text = text.replace("70 80 -90", "70 80 -90"[: 3 * count]).replace("71 81 -91", "71 81 -91"[: 3 * count])
    text = text.replace("72 82 -92", "72 82 -92"[: 3 * count])
    angles = np.radians(np.array([70.0, 80.0, -90.0])[columns])
    np.testing.assert_allclose(bvh.parse(text).rotations[0, 2], quat.from_euler(order, angles), atol=1e-15)


def test_a_joint_without_channels_and_tip_does_not_turn():
    text = changed("CHANNELS 3 Yrotation Zrotation Xrotation", "CHANNELS 0")
    text = text.replace(" 70 80 -90", "").replace(" 71 81 -91", "").replace(" 72 82 -92", "")
    text = text.replace("      End Site\n      {\n        OFFSET 0 0.2 0\n      }\n", "")
    motion = bvh.parse(text)
    np.testing.assert_array_equal(motion.rotations[:, 2], np.tile([0.0, 0, 0, 1], (3, 1)))
    assert len(motion.skeleton.tip_parents) == 0


def test_position_and_rotation_channels_may_alternate():
    text = changed(
        "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation",
        "CHANNELS 6 Zrotation Xposition Xrotation Zposition Yrotation Yposition",
    )
    motion = bvh.parse(text)
    np.testing.assert_array_equal(motion.root[0], [0.9, 30, 10])
    np.testing.assert_allclose(motion.rotations[0, 0], quat.from_euler("ZXY", np.radians([0.1, 0.2, 20])), atol=1e-15)


def test_a_root_without_position_channels_stands_at_its_offset():
    text = changed("CHANNELS 6 Xposition Yposition Zposition ", "CHANNELS 3 ")
    text = text.replace("OFFSET 0 0 0", "OFFSET 1 2 3")
    for start in ("0.1 0.9 0.2 ", "0.2 0.8 0.3 ", "0.3 0.7 0.4 "):
        text = text.replace(start, "")
    motion = bvh.parse(text, unit="cm")
    np.testing.assert_allclose(motion.root, np.tile([0.01, 0.02, 0.03], (3, 1)))
    np.testing.assert_array_equal(motion.skeleton.offsets[0], [0, 0, 0])


def test_position_channels_of_the_root_replace_its_offset_axis_by_axis():
    text = changed("OFFSET 0 0 0", "OFFSET 5 6 7")
    np.testing.assert_array_equal(bvh.parse(text).root, bvh.parse(VALID).root)
    text = text.replace("6 Xposition Yposition Zposition ", "4 Yposition ")
    for row, start in zip(ROWS, ("0.1 0.9 0.2", "0.2 0.8 0.3", "0.3 0.7 0.4"), strict=True):
        text = text.replace(row, row.replace(start, start.split()[1]))
    np.testing.assert_array_equal(bvh.parse(text).root, [[5, 0.9, 7], [5, 0.8, 7], [5, 0.7, 7]])


def chest_with_positions(first: str, second: str, third: str) -> str:
    text = changed("3 Xrotation Yrotation Zrotation", "5 Xrotation Zposition Xposition Yrotation Zrotation")
    for row, degrees, place in zip(ROWS, ("40 ", "41 ", "42 "), (first, second, third), strict=True):
        text = text.replace(row, row.replace(degrees, f"{degrees}{place} "))
    return text


def test_constant_position_channels_of_another_joint_become_its_offset():
    motion = bvh.parse(chest_with_positions("30 20", "30 20", "30.00009 20"), unit="cm")
    np.testing.assert_allclose(motion.skeleton.offsets[1], [0.2, 0.01, 0.3], atol=1e-15)
    np.testing.assert_array_equal(motion.rotations, bvh.parse(VALID).rotations)


def test_position_channels_that_stretch_a_joint_too_far_are_refused():
    with pytest.raises(MotionFileError) as caught:
        bvh.parse(chest_with_positions("30 20", "30 20.5", "30 20"), unit="cm", stretch_m=0.003)
    assert caught.value.line == 6
    assert caught.value.expected == "joint 'Chest' within 3 mm of its mean offset (stretch_m)"
    assert caught.value.found == "3.3 mm at frame 1"
    assert "allow more with stretch_m" in caught.value.advice


@pytest.mark.parametrize(
    ("text", "fps"),
    [
        ("0.03333333", 30.0),
        (".033333", 30.0),
        ("0.0333333333", 30.0),
        ("3.333333e-2", 30.0),
        ("0.0083333", 120.0),
        ("0.01666667", 60.0),
        ("0.04166667", 24.0),
        ("0.033366667", 30 / 1.001),
        ("0.0166833", 60 / 1.001),
        ("0.041708", 24 / 1.001),
        ("1", 1.0),
        ("0.0333", 1 / 0.0333),
        ("2.5", 0.4),
    ],
)
def test_rounded_frame_times_become_the_rate_that_was_meant(text, fps):
    assert bvh.parse(changed("0.03333333", text)).fps == fps


def test_deep_nesting_is_no_limit():
    depth = MAX_JOINTS
    lines = ["HIERARCHY"]
    for joint in range(depth):
        lines += [f"{'JOINT' if joint else 'ROOT'} j{joint}", "{", "OFFSET 0 1 0", "CHANNELS 1 Xrotation"]
    lines += ["}"] * depth + ["MOTION", "Frames: 1", "Frame Time: 1", "1 " * depth]
    motion = bvh.parse("\n".join(lines))
    assert len(motion.skeleton) == depth
    np.testing.assert_allclose(bvh.parse(bvh.dump(motion)).rotations, motion.rotations, atol=1e-7)


def test_the_careful_reader_and_the_quick_one_agree(monkeypatch):
    quick = bvh.parse(VALID)
    monkeypatch.setattr(bvh_reader, "_quick_table", lambda *_: None)
    assert_same(bvh.parse(VALID), quick)


# --- what is refused --------------------------------------------------------------------------------------


def too_many(frames: int, row: str) -> tuple[str, str]:
    return f"the end after {frames} rows (Frames: on line 22)", f"another row, '{row}'"


ONE_OF = "one of Xposition, Yposition, Zposition, Xrotation, Yrotation, Zrotation"
NUMBER = "a number between -1e+09 and 1e+09"
AFTER_ROOT = "MOTION or another ROOT after the ROOT block"
ONCE = "OFFSET and CHANNELS, once each, in joint 'Chest'"
NEXT_IN_HIPS, NEXT_IN_CHEST = (f"JOINT, End Site or '}}' in joint '{name}'" for name in ("Hips", "Chest"))
COUNT = "a number from 0 to 6 after CHANNELS"
FRAMES, SECONDS = "'Frames:' and a whole number", "'Frame Time:' and seconds"
RANGE = "a frame time of 1e-06 to 60.0 s"
TURNS = "CHANNELS 3 Xrotation Yrotation Zrotation"
END = "the end of the file"

# What is put in the place of what, and the line, the expectation and the finding that the error must state.
REFUSED = {
    "another format": ("HIERARCHY", "; FBX 7.3.0", 1, "HIERARCHY", "'; FBX 7.3.0'"),
    "null bytes": ("HIERARCHY", "\0" * 9, 1, "HIERARCHY", repr("\0" * 9)),
    "no root": ("ROOT Hips", "JOINT Hips", 2, "ROOT and a name", "'JOINT Hips'"),
    "root without a name": ("ROOT Hips", "ROOT", 2, "a joint name", "the end of the line"),
    "joint without a name": ("JOINT Chest", "JOINT", 6, "a joint name", "the end of the line"),
    "empty second root": (
        "MOTION",
        "ROOT Other\n{\n}\nMOTION",
        23,
        "OFFSET and CHANNELS, once each, in joint 'Other'",
        "'}'",
    ),
    "root inside": ("JOINT Chest", "ROOT Chest", 6, NEXT_IN_HIPS, "'ROOT Chest'"),
    "duplicate name": (
        "JOINT Head",
        "JOINT Hips",
        10,
        "joint names that differ",
        "'Hips' again, first on line 2",
    ),
    "missing opening brace": ("Chest\n  {", "Chest\n", 8, "'{' after joint 'Chest'", "'OFFSET 0 1 0'"),
    "missing closing brace": ("  }\n}\n", "}\n", 20, NEXT_IN_HIPS, "'MOTION'"),
    "extra closing brace": ("MOTION", "}\nMOTION", 21, AFTER_ROOT, "'}'"),
    "cut in the header": (VALID[VALID.index("    JOINT Head") :], "", 9, NEXT_IN_CHEST, END),
    "no offset": ("    OFFSET 0 1 0\n", "", 9, ONCE, "'JOINT Head'"),
    "two offsets": ("OFFSET 0 1 0", "OFFSET 0 1 0\nOFFSET 0 2 0", 9, ONCE, "'OFFSET 0 2 0'"),
    "no channels": (TURNS, "", 10, ONCE, "'JOINT Head'"),
    "two channel lists": ("OFFSET 0 1 0", "OFFSET 0 1 0\nCHANNELS 0", 10, NEXT_IN_CHEST, f"'{TURNS}'"),
    "short offset": ("OFFSET 0 1 0", "OFFSET 0 1", 8, "3 numbers after OFFSET", "2"),
    "offset of words": ("OFFSET 0 1 0", "OFFSET 0 up 0", 8, NUMBER, "'up'"),
    "offset of nan": ("OFFSET 0 1 0", "OFFSET 0 nan 0", 8, NUMBER, "'nan'"),
    "no channel count": (TURNS, "CHANNELS", 9, COUNT, "nothing"),
    "channel count in words": ("3 Xrotation", "three Xrotation", 9, COUNT, "'three'"),
    "negative channel count": ("3 Xrotation", "-3 Xrotation", 9, COUNT, "'-3'"),
    "too few channels": ("3 Xrotation", "4 Xrotation", 9, "4 channel names on joint 'Chest'", "3"),
    "too many channels": ("3 Xrotation", "2 Xrotation", 9, "2 channel names on joint 'Chest'", "3"),
    "unknown channel": ("3 Xrotation", "3 Wrotation", 9, ONE_OF, "'Wrotation'"),
    "duplicate channel": ("3 X", "3 z", 9, "each channel once on joint 'Chest'", "Zrotation twice"),
    "tip without offset": ("OFFSET 0 0.2 0", "", 17, "OFFSET of the End Site", "'}'"),
    "tip with a child": ("0.2 0\n", "0.2 0\nJOINT x\n", 17, "'}' after the End Site's OFFSET", "'JOINT x'"),
    "tip with wrong channels": ("0.2 0\n", "0.2 0\nCHANNELS 1 up\n", 17, ONE_OF, "'up'"),
    "tip with channels without values": ("0.2 0\n", "0.2 0\nCHANNELS 1 Xrotation\n", 25, "13 values", "12"),
    "tip without brace": ("Site\n      {", "Site", 15, "'{' after End Site", "'OFFSET 0 0.2 0'"),
    "endless line": ("Chest", "x" * 5000, 6, "at most 1000 characters on a header line", "more"),
    "no motion section": (VALID[VALID.index("MOTION") :], "", 20, AFTER_ROOT, END),
    "nothing after motion": (VALID[VALID.index("Frames:") :], "", 21, FRAMES, END),
    "no frames": ("Frames: 3\n", "", 22, FRAMES, "'Frame Time: 0.03333333'"),
    "frames in words": ("Frames: 3", "Frames: many", 22, FRAMES, "'Frames: many'"),
    "half a frame": ("Frames: 3", "Frames: 2.5", 22, FRAMES, "'Frames: 2.5'"),
    "negative frames": ("Frames: 3", "Frames: -3", 22, FRAMES, "'Frames: -3'"),
    "zero frames": ("Frames: 3", "Frames: 0", 22, "1 to 200000 frames", "0"),
    "too many frames": (
        "Frames: 3",
        f"Frames: {MAX_FRAMES + 1}",
        22,
        "1 to 200000 frames",
        str(MAX_FRAMES + 1),
    ),
    "endless frames": ("Frames: 3", "Frames: " + "9" * 900, 22, FRAMES, f"'Frames: {'9' * 32}…'"),
    "no frame time": ("Frame Time: 0.03333333\n", "", 23, SECONDS, f"'{ROWS[0]}'"),
    "frame time in milliseconds": ("0.03333333", "33.3 ms", 23, SECONDS, "'Frame Time: 33.3 ms'"),
    "zero frame time": ("0.03333333", "0", 23, RANGE, "0"),
    "negative frame time": ("0.03333333", "-0.033", 23, RANGE, "-0.033"),
    "vanishing frame time": ("0.03333333", "1e-320", 23, RANGE, "1e-320"),
    "nan frame time": ("0.03333333", "nan", 23, NUMBER, "'nan'"),
    "infinite frame time": ("0.03333333", "inf", 23, NUMBER, "'inf'"),
    "last row cut": (" -92\n", "", 26, "12 values", "11"),
    "row cut, one more row after": (" 71 81 -91", "", 25, "12 values", "9"),
    "a value on the wrong line": (" -90\n0.2", "\n-90 0.2", 24, "12 values", "11"),
    "a row too long": ("-91", "-91 0", 25, "12 values", "13"),
    "a row far too long": ("-91", "-91" + " 0" * 900, 25, "12 values", "far more"),
    "states 5, has 3": ("Frames: 3", "Frames: 5", 22, "5 rows of values to follow", "3 rows"),
    "states 200000, has 3": ("Frames: 3", "Frames: 200000", 22, "200000 rows of values to follow", "3 rows"),
    "states 2, has 3": ("Frames: 3", "Frames: 2", 26, *too_many(2, ROWS[2])),
    "text after the rows": ("-92\n", "-92\nthanks\n", 27, *too_many(3, "thanks")),
    "no rows": ("\n".join(ROWS), "", 22, "3 rows of values to follow", "0 rows"),
    "nan": ("-91", "nan", 25, NUMBER, "'nan'"),
    "infinity": ("-91", "-Infinity", 25, NUMBER, "'-Infinity'"),
    "overflow": ("-91", "1e999", 25, NUMBER, "'1e999'"),
    "a length beyond reason": ("0.8 0.3", "1e300 0.3", 25, NUMBER, "'1e300'"),
    "a word": ("-91", "left", 25, NUMBER, "'left'"),
    "a comma": ("0.2 0.8", "0,2 0.8", 25, NUMBER, "'0,2'"),
    "two points": ("-91", "9.1.0", 25, NUMBER, "'9.1.0'"),
    "an underscore": ("-91", "9_1", 25, NUMBER, "'9_1'"),
    "digits of another script": ("-91", "٩١", 25, NUMBER, "'٩١'"),
    "a hexadecimal": ("-91", "0x1F", 25, NUMBER, "'0x1F'"),
    "a null byte": ("-91", "-91\0", 25, NUMBER, repr("-91\0")),
    "a brace": ("-91", "}", 25, NUMBER, "'}'"),
    "a word before a cut row": ("-91\n0.3", "left\n", 25, NUMBER, "'left'"),
    "nan after a cut row": (" -91\n0.3", "\nnan", 25, "12 values", "11"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_wrong_file_is_refused_with_its_line(name, tmp_path):
    old, new, line, expected, found = REFUSED[name]
    path = tmp_path / "wrong.bvh"
    path.write_bytes(changed(old, new).encode())
    with pytest.raises(MotionFileError) as caught:
        bvh.read(path)
    error = caught.value
    assert (error.path, error.line, error.expected, error.found) == (str(path), line, expected, found)
    assert str(error) == f"{path}:{line}: expected {expected}, found {found}"


@pytest.mark.parametrize("text", ["", "\n \n\t\n", "\ufeff"])
def test_an_empty_file_is_refused(text):
    with pytest.raises(MotionFileError, match=r"^<text>:1: expected HIERARCHY, found the end of the file$"):
        bvh.parse(text)


def test_a_file_cut_anywhere_before_its_last_value_is_refused():
    for length in range(VALID.rindex("-92")):
        with pytest.raises(MotionFileError, match="found"):
            bvh.parse(VALID[:length])


@pytest.mark.parametrize("line_end", ["\r\n", "\r", "\n\n"])
def test_lines_are_counted_with_any_line_end(line_end):
    with pytest.raises(MotionFileError) as caught:
        bvh.parse(changed("-91", "nan").replace("\n", line_end))
    assert caught.value.line == (25 if line_end != "\n\n" else 49)
    assert caught.value.path == "<text>"


def test_the_text_may_be_given_a_name():
    with pytest.raises(MotionFileError, match=r"^upload walk\.bvh:1: expected"):
        bvh.parse("", name="upload walk.bvh")


def joints(count: int, tips: int = 0) -> str:
    head = "ROOT j0\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n"
    block = "JOINT j%d\n{\nOFFSET 0 1 0\nCHANNELS 0\n}\n"
    ends = "End Site\n{\nOFFSET 0 1 0\n}\n" * tips
    body = "".join(block % joint for joint in range(1, count))
    return f"HIERARCHY\n{head}{body}{ends}}}\nMOTION\nFrames: 1\nFrame Time: 0.1\n5\n"


def test_as_many_joints_and_tips_as_allowed_are_read():
    motion = bvh.parse(joints(MAX_JOINTS, MAX_JOINTS))
    assert len(motion.skeleton) == len(motion.skeleton.tip_parents) == MAX_JOINTS


def test_one_joint_more_is_refused():
    with pytest.raises(MotionFileError) as caught:
        bvh.parse(joints(MAX_JOINTS + 1))
    assert caught.value.line == 6 + 5 * (MAX_JOINTS - 1)
    assert caught.value.expected == f"at most {MAX_JOINTS} joints"
    assert caught.value.found == f"another joint, 'j{MAX_JOINTS}'"


def test_one_tip_more_is_refused():
    with pytest.raises(MotionFileError, match=f"<text>:4006: expected at most {MAX_JOINTS} End Sites, found another"):
        bvh.parse(joints(1, MAX_JOINTS + 1))


def test_a_small_file_cannot_claim_much_memory():
    text = joints(MAX_JOINTS).replace("Frames: 1", f"Frames: {MAX_FRAMES}") + "5\n" * (MAX_FRAMES - 1)
    with pytest.raises(MotionFileError) as caught:
        bvh.parse(text)
    assert caught.value.expected == "at most 20000000 frames × joints"
    assert caught.value.found == f"{MAX_FRAMES} × {MAX_JOINTS}"


def test_a_skeleton_without_any_channel_is_refused():
    with pytest.raises(MotionFileError, match="expected at least one channel in the header, found none"):
        bvh.parse(joints(2).replace("CHANNELS 1 Xrotation", "CHANNELS 0"))
