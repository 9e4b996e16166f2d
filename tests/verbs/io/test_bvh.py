from __future__ import annotations

import itertools
import os
import stat
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from verbs.conventions import MAX_FILE_BYTES, METRES_PER_UNIT
from verbs.errors import MotionFileError, OutOfRange, UnknownName
from verbs.io import bvh
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton

ORDERS = ["".join(axes) for axes in itertools.permutations("XYZ")]

VALID = (Path(__file__).parent / "valid.bvh").read_text()


def rotation_error(left: Motion, right: Motion) -> float:
    """Largest angle between the rotations of two motions, radians."""
    between = quat.mul(quat.conjugate(left.rotations), right.rotations)
    return float(np.linalg.norm(quat.log(between), axis=-1).max())


# --- files ---------------------------------------------------------------------------------------------


def test_a_missing_file_has_no_line(tmp_path):
    with pytest.raises(MotionFileError, match="expected a file that can be read, found No such file") as caught:
        bvh.read(tmp_path / "missing.bvh")
    assert caught.value.line is None
    assert caught.value.path == str(tmp_path / "missing.bvh")


@pytest.mark.parametrize("path", ["", ".", "a\0b.bvh", "x" * 5000])
def test_a_path_that_is_no_file_is_refused(path):
    with pytest.raises(MotionFileError, match=r"expected a (regular )?file"):
        bvh.read(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_refused_instead_of_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.bvh")
    with pytest.raises(MotionFileError, match="expected a regular file"):
        bvh.read(tmp_path / "pipe.bvh")


def test_a_file_over_the_limit_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "large.bvh"
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)  # sparse: takes no room
    with pytest.raises(MotionFileError) as caught:
        bvh.read(path)
    assert (caught.value.line, caught.value.found) == (None, f"{MAX_FILE_BYTES + 1} bytes")
    assert caught.value.expected == f"at most {MAX_FILE_BYTES} bytes"


def test_text_over_the_limit_is_refused(monkeypatch):
    monkeypatch.setattr(bvh, "MAX_FILE_BYTES", 100)
    with pytest.raises(MotionFileError, match=r"expected at most 100 bytes, found [0-9]+ characters"):
        bvh.parse(VALID)


@pytest.mark.parametrize(
    ("content", "line", "found"),
    [
        (VALID.encode("utf-16"), 1, "byte 0xff"),
        (VALID.replace("Chest", "Brustkörper").encode("latin-1"), 6, "byte 0xf6"),
        (b"\x89PNG\r\n\x1a\n", 1, "byte 0x89"),
        (VALID.encode() + b"\xc3", 27, "byte 0xc3"),
    ],
)
def test_bytes_that_are_not_utf8_are_refused_with_their_line(content, line, found, tmp_path):
    (tmp_path / "wrong.bvh").write_bytes(content)
    with pytest.raises(MotionFileError) as caught:
        bvh.read(tmp_path / "wrong.bvh")
    assert (caught.value.line, caught.value.expected, caught.value.found) == (line, "UTF-8 text", found)


@pytest.mark.parametrize(("unit", "metres"), METRES_PER_UNIT.items())
def test_lengths_come_out_in_metres(unit, metres):
    motion, plain = bvh.parse(VALID, unit=unit), bvh.parse(VALID)
    np.testing.assert_allclose(motion.root, plain.root * metres)
    np.testing.assert_allclose(motion.skeleton.offsets, plain.skeleton.offsets * metres)
    np.testing.assert_allclose(motion.skeleton.tip_offsets, plain.skeleton.tip_offsets * metres)
    np.testing.assert_array_equal(motion.rotations, plain.rotations)


def test_an_unknown_unit_lists_the_known_ones():
    with pytest.raises(UnknownName, match="unknown unit 'yd'; known: m, dm, cm, mm, in, ft"):
        bvh.parse(VALID, unit="yd")


def mutated(rng: np.random.Generator) -> bytes:
    """Return a valid file with one to four wounds: bytes changed, cut out, doubled, put in, cut off."""
    content = bytearray(VALID.encode())
    for _ in range(rng.integers(1, 5)):
        start = int(rng.integers(len(content) + 1))
        stop = min(start + int(rng.integers(1, 20)), len(content))
        wound = rng.integers(6)
        if wound == 0:
            content[start:stop] = rng.bytes(stop - start)
        elif wound == 1:
            del content[start:stop]
        elif wound == 2:
            content[stop:stop] = content[start:stop]
        elif wound == 3:
            content[start:start] = rng.choice([b"{", b"}", b"\n", b" ", b"0", b"-", b".", b"e", b"nan", b"\0"])
        elif wound == 4:
            content[start:stop] = bytes(reversed(content[start:stop]))
        elif rng.random() < 0.2:
            del content[start:]
    return bytes(content)


def test_a_damaged_file_gives_a_motion_or_a_motion_file_error(tmp_path):
    rng = np.random.default_rng(0)
    path = tmp_path / "damaged.bvh"
    refused = 0
    for _ in range(2000):
        path.write_bytes(mutated(rng))
        try:
            assert isinstance(bvh.read(path), Motion)
        except MotionFileError:
            refused += 1
    assert 1000 < refused < 2000  # else the wounds are too small or too deep to test anything


# --- what is written --------------------------------------------------------------------------------------


def some_motion(seed: int, joint_count: int = 6, frames: int = 20, fps: float = 30.0) -> Motion:
    """Smooth turns, in which some frames stand exactly in gimbal lock; joints are not always depth-first."""
    rng = np.random.default_rng(seed)
    parents = np.array([-1, *(int(rng.integers(joint)) for joint in range(1, joint_count))])
    offsets = rng.normal(size=(joint_count, 3))
    offsets[0] = 0.0
    tip_parents = np.sort(rng.integers(joint_count, size=rng.integers(4)))
    names = tuple(f"joint {joint}" for joint in range(joint_count))
    skeleton = Skeleton(names, parents, offsets, tip_parents, rng.normal(size=(len(tip_parents), 3)))
    turns = rng.normal(size=(joint_count, 3)) * np.linspace(0, 4, frames)[:, None, None]
    rotations = quat.mul(quat.normalize(rng.normal(size=(joint_count, 4))), quat.exp(turns))
    angles = rng.uniform(-3, 3, (frames // 4, joint_count, 3))
    angles[..., 1] = rng.choice([-0.5, 0.5, 0.0, 1.0], size=angles.shape[:2]) * np.pi
    rotations[1 : 1 + len(angles)] = quat.from_euler(ORDERS[seed % 6], angles)
    return Motion(skeleton, fps, rng.normal(size=(frames, 3)), rotations)


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 9),
    st.integers(1, 24),
    st.sampled_from(ORDERS),
    st.sampled_from([24.0, 30.0, 60.0, 120.0, 30 / 1.001, 60 / 1.001, 1000.0, 12.5]),
)
@settings(max_examples=60, deadline=None)
def test_reading_what_was_written_gives_the_same_motion(seed, joint_count, frames, order, fps):
    motion = some_motion(seed, joint_count, frames, fps)
    again = bvh.parse(bvh.dump(motion, order=order))
    # The file names joints depth first; elsewhere they may only stand after their parents.
    places = [motion.skeleton.index(name) for name in again.skeleton.names]
    parents = [places[parent] if parent >= 0 else -1 for parent in again.skeleton.parents]
    np.testing.assert_array_equal(parents, motion.skeleton.parents[places])
    np.testing.assert_allclose(again.skeleton.offsets, motion.skeleton.offsets[places], atol=6e-7)
    assert again.fps == fps
    np.testing.assert_allclose(again.root, motion.root, atol=6e-7)
    ordered = Motion(again.skeleton, fps, motion.root, motion.rotations[:, places])
    assert rotation_error(again, ordered) < 1e-7


@given(st.floats(0.02, 1000.0))
@example(953.0625)  # near 953, and nearer to 954 / 1.001
@settings(max_examples=60, deadline=None)
def test_any_rate_survives_within_the_resolution_of_rates(fps):
    again = bvh.parse(bvh.dump(some_motion(0, 1, 2, fps))).fps
    assert again == pytest.approx(fps, rel=5.1e-5)
    assert bvh.parse(bvh.dump(some_motion(0, 1, 2, again))).fps == pytest.approx(again, rel=1e-15)


def test_thirty_frames_per_second_are_written_as_everyone_writes_them():
    assert "\nFrame Time: 0.03333333\n" in bvh.dump(bvh.parse(VALID))


def test_the_written_file_is_laid_out_as_the_format_asks():
    motion = bvh.parse(VALID)
    root = np.array([[0.1, -0.0000001, 2.0]])
    still = Motion(motion.skeleton, 60.0, root, np.tile([0.0, 0.0, 0.0, 1.0], (1, 3, 1)))
    assert bvh.dump(still, order="XYZ", decimals=3) == (
        "HIERARCHY\n"
        "ROOT Hips\n"
        "{\n"
        "\tOFFSET 0.000 0.000 0.000\n"
        "\tCHANNELS 6 Xposition Yposition Zposition Xrotation Yrotation Zrotation\n"
        "\tJOINT Chest\n"
        "\t{\n"
        "\t\tOFFSET 0.000 1.000 0.000\n"
        "\t\tCHANNELS 3 Xrotation Yrotation Zrotation\n"
        "\t\tJOINT Head\n"
        "\t\t{\n"
        "\t\t\tOFFSET 0.000 0.500 0.100\n"
        "\t\t\tCHANNELS 3 Xrotation Yrotation Zrotation\n"
        "\t\t\tEnd Site\n"
        "\t\t\t{\n"
        "\t\t\t\tOFFSET 0.000 0.200 0.000\n"
        "\t\t\t}\n"
        "\t\t}\n"
        "\t}\n"
        "}\n"
        "MOTION\n"
        "Frames: 1\n"
        "Frame Time: 0.01666667\n"
        "0.100 0.000 2.000 " + " ".join(["0.000"] * 9) + "\n"
    )


def test_tips_survive_and_leaves_without_one_get_one_of_no_length():
    skeleton = Skeleton(
        ("a", "b", "c"),
        np.array([-1, 0, 0]),
        np.zeros((3, 3)),
        np.array([0, 2, 2]),
        np.arange(9.0).reshape(3, 3),
    )
    again = bvh.parse(bvh.dump(Motion(skeleton, 30.0, np.zeros((1, 3)), np.tile([0.0, 0, 0, 1], (1, 3, 1))))).skeleton
    np.testing.assert_array_equal(again.tip_parents, [0, 1, 2, 2])
    np.testing.assert_array_equal(again.tip_offsets, [[0, 1, 2], [0, 0, 0], [3, 4, 5], [6, 7, 8]])


def test_equal_motions_give_equal_bytes():
    assert bvh.dump(some_motion(3)) == bvh.dump(some_motion(3))


def written_angles(motion: Motion, order: str) -> np.ndarray:
    """Euler angles (F, 3) of the first joint as they stand in the file, degrees."""
    rows = bvh.dump(motion, order=order).split("Frame Time: ")[1].splitlines()[1:]
    return np.array([[float(word) for word in row.split()[3:6]] for row in rows])


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("outer", [(0.0, 0.0), (0.3, -0.8), (-2.0, 2.5)])
def test_a_turn_through_gimbal_lock_stays_the_curve_it_was(order, outer):
    # 721 frames from 0 to 2 full turns of the middle angle: frames 90, 270, … stand exactly in the lock.
    middle = np.linspace(0, 720, 721)
    curves = np.stack([np.full(721, np.degrees(outer[0])), middle, np.full(721, np.degrees(outer[1]))], axis=-1)
    curves += np.sin(np.radians(middle))[:, None] * [5.0, 0.0, 5.0]
    rotations = quat.from_euler(order, np.radians(curves))[:, None]
    rotations *= np.random.default_rng(0).choice([-1.0, 1.0], size=(721, 1, 1))
    skeleton = Skeleton(("root",), np.array([-1]), np.zeros((1, 3)))
    written = written_angles(Motion(skeleton, 60.0, np.zeros((721, 3)), rotations), order)
    away = np.abs(np.cos(np.radians(middle))) > 1e-3
    np.testing.assert_allclose(written[away], curves[away], atol=1e-5)
    # In the lock itself only a sum of the outer angles is known; one of them keeps its last value.
    assert np.abs(np.diff(written, axis=0)).max() < 1.1


def test_angles_are_unwrapped_over_full_turns():
    turns = quat.from_euler("Y", np.linspace(0, 6 * np.pi, 200)[:, None, None])
    skeleton = Skeleton(("root",), np.array([-1]), np.zeros((1, 3)))
    written = written_angles(Motion(skeleton, 60.0, np.zeros((200, 3)), turns), "ZXY")
    np.testing.assert_allclose(written, np.linspace([0, 0, 0], [0, 0, 1080], 200), atol=1e-6)


def test_an_unknown_order_lists_the_known_ones():
    with pytest.raises(UnknownName, match="unknown rotation order 'XYX'; known: XYZ, XZY, YXZ, YZX, ZXY, ZYX"):
        bvh.dump(some_motion(0), order="XYX")


@pytest.mark.parametrize("decimals", [0, -1, 13])
def test_decimals_are_bounded(decimals):
    with pytest.raises(OutOfRange, match=f"decimals must be 1 to 12, not {decimals}"):
        bvh.dump(some_motion(0), decimals=decimals)


@pytest.mark.parametrize("fps", [0.01, 2e6])
def test_a_rate_that_could_not_be_read_back_is_not_written(fps):
    with pytest.raises(OutOfRange, match=r"a BVH file's rate is 0.0167 to 1000000 fps"):
        bvh.dump(some_motion(0, fps=fps))


@pytest.mark.parametrize("name", ["", " Hips", "Hips ", "a{b", "a}b", "two\nlines", "x" * 1000])
def test_a_name_that_could_not_be_read_back_is_not_written(name):
    motion = Motion(Skeleton((name,), np.array([-1]), np.zeros((1, 3))), 30.0, np.zeros((1, 3)), np.ones((1, 1, 4)) / 2)
    with pytest.raises(MotionFileError, match="expected a joint name of one line without braces, found '"):
        bvh.dump(motion)


def test_a_written_file_holds_the_dumped_text_and_replaces_the_old_one(tmp_path):
    path = tmp_path / "motion.bvh"
    path.write_text("old")
    bvh.write(some_motion(1), path, order="YZX", decimals=4)
    assert path.read_bytes() == bvh.dump(some_motion(1), order="YZX", decimals=4).encode()
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(os.name != "posix", reason="permissions are POSIX ones")
def test_a_written_file_has_ordinary_permissions(tmp_path):
    (tmp_path / "plain").touch()
    bvh.write(some_motion(1), tmp_path / "motion.bvh")
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("plain", "motion.bvh")]
    assert modes[0] == modes[1]


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing_behind(tmp_path, monkeypatch):
    path = tmp_path / "motion.bvh"
    path.write_text("old")

    def full_disk(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(MotionFileError, match="expected a file that can be written, found No space left"):
        bvh.write(some_motion(1), path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("path", ["missing/motion.bvh", "a\0b.bvh"])
def test_a_path_that_cannot_be_written_is_refused(path, tmp_path):
    with pytest.raises(MotionFileError, match="expected a file that can be written") as caught:
        bvh.write(some_motion(1), tmp_path / path)
    assert caught.value.line is None


def test_real_capture_survives_writing(mocap):
    for path in sorted(mocap.rglob("*.bvh"))[::10]:
        motion = bvh.read(path)
        again = bvh.parse(bvh.dump(motion))
        assert again.skeleton.difference(motion.skeleton, tolerance_m=1e-6) is None
        assert again.fps == motion.fps == 30.0
        assert rotation_error(again, motion) < 1e-7
        np.testing.assert_allclose(again.root, motion.root, atol=1e-6)


def test_the_module_exports_its_six_functions():
    assert bvh.__all__ == ["dump", "parse", "parse_file", "read", "read_file", "write"]
