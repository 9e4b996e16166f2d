"""Motions in .npz archives: round trips, other writers' layouts, archives that are wrong or hostile."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.verbs import clip_files
from tests.verbs.io.test_bvh import some_motion
from verbs.errors import MotionFileError, UnknownName
from verbs.io import motion_files, npz
from verbs.io.report import Marks
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.skeleton import Skeleton


def arrays_of(motion: Motion) -> dict[str, np.ndarray]:
    """The required arrays, as another program would save them."""
    skeleton = motion.skeleton
    return {
        "joint_names": np.array(skeleton.names),
        "parents": np.asarray(skeleton.parents),
        "offsets": np.asarray(skeleton.offsets),
        "rotation_matrices": quat.to_matrix(motion.rotations),
        "root_positions": motion.root,
        "fps": np.array(motion.fps),
    }


def saved(folder: Path, arrays: dict[str, np.ndarray], name: str = "clip.npz") -> Path:
    np.savez(folder / name, **arrays)
    return folder / name


def angle(left, right) -> float:
    return float(np.linalg.norm(quat.log(quat.mul(quat.conjugate(left), right)), axis=-1).max())


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 24), st.sampled_from([24.0, 30 / 1.001, 120.0]))
@settings(max_examples=40, deadline=None)
def test_reading_what_was_written_gives_the_same_motion(tmp_path_factory, seed, joints, frames, fps):
    motion, path = some_motion(seed, joints, frames, fps), tmp_path_factory.getbasetemp() / "clip.npz"
    npz.write(motion, path)
    again = npz.read_file(path).motion
    assert again.skeleton.difference(motion.skeleton, tolerance_m=0.0) is None
    np.testing.assert_array_equal(again.skeleton.tip_parents, motion.skeleton.tip_parents)
    np.testing.assert_array_equal(again.skeleton.tip_offsets, motion.skeleton.tip_offsets)
    assert again.fps == fps
    np.testing.assert_array_equal(again.root, motion.root)
    assert angle(again.rotations, motion.rotations) < 1e-12


def test_equal_motions_give_equal_bytes(tmp_path):
    for name in ("a.npz", "b.npz"):
        npz.write(some_motion(3), tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@given(st.integers(0, 2**32 - 1), st.sampled_from(["<f8", "<f4", ">f8"]), st.sampled_from(["C", "F"]))
@settings(max_examples=30, deadline=None)
def test_matrices_are_read_in_any_precision_and_order(tmp_path_factory, seed, dtype, order):
    motion = some_motion(seed)
    arrays = arrays_of(motion)
    arrays["rotation_matrices"] = np.asarray(arrays["rotation_matrices"].astype(dtype), order=order)
    file = npz.read_file(saved(tmp_path_factory.getbasetemp(), arrays))
    assert angle(file.motion.rotations, motion.rotations) < (1e-6 if "4" in dtype else 1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_matrices_of_half_turns_are_read(axis, tmp_path):
    motion = some_motion(0, 2, 2)
    vector = np.zeros(3)
    vector[axis] = np.pi
    arrays = arrays_of(Motion(motion.skeleton, 30.0, motion.root, np.tile(quat.exp(vector), (2, 2, 1))))
    rotations = npz.read_file(saved(tmp_path, arrays)).motion.rotations
    np.testing.assert_allclose(np.abs(rotations[..., axis]), 1.0)


def test_numpy_reads_what_is_written(tmp_path):
    motion = clip_files.walk()
    npz.write(motion, tmp_path / "clip.npz", contacts=Marks(("LeftFoot",), np.ones((31, 1))))
    with np.load(tmp_path / "clip.npz", allow_pickle=False) as found:
        assert tuple(found["joint_names"]) == motion.skeleton.names
        np.testing.assert_array_equal(found["rotations"], motion.rotations)
        assert found["contact_names"].tolist() == ["LeftFoot"]


@pytest.mark.parametrize("dtype", [bool, np.float32, np.uint8])
def test_contacts_are_reported(dtype, tmp_path):
    motion = clip_files.walk()
    values = (np.arange(62).reshape(31, 2) % 3 == 0).astype(dtype)
    more = {"contacts": values, "contact_names": np.array(["LeftFoot", "RightFoot"])}
    marks = motion_files.read(saved(tmp_path, arrays_of(motion) | more)).report.contacts
    assert marks.names == ("LeftFoot", "RightFoot")
    np.testing.assert_array_equal(marks.values, values.astype(float))


def test_lengths_are_in_the_unit_given_and_other_arrays_are_ignored(tmp_path):
    motion = clip_files.walk()
    path = saved(tmp_path, arrays_of(motion) | {"betas": np.zeros(10), "text": np.array("a walk")})
    found = npz.read_file(path, unit="cm").motion
    np.testing.assert_allclose(found.root, 0.01 * motion.root)
    np.testing.assert_allclose(found.skeleton.offsets, 0.01 * motion.skeleton.offsets)
    with pytest.raises(UnknownName, match="unknown unit 'yd'"):
        npz.read_file(path, unit="yd")


def test_a_joint_that_is_named_becomes_the_root(tmp_path):
    motion = some_motion(0, 4, 5)
    skeleton = Skeleton(motion.skeleton.names, np.array([-1, 0, 1, 1]), motion.skeleton.offsets)
    arrays = arrays_of(Motion(skeleton, motion.fps, motion.root, motion.rotations))
    file = npz.read_file(saved(tmp_path, arrays), root="joint 1")
    assert file.motion.skeleton.names == ("joint 1", "joint 2", "joint 3")
    np.testing.assert_allclose(file.report.folded[0].positions, motion.root)


def test_a_clip_cannot_be_chosen(tmp_path):
    with pytest.raises(MotionFileError, match="an .npz file holds one motion, found clip 1"):
        motion_files.read(saved(tmp_path, arrays_of(clip_files.walk())), clip=1)


MATRIX = np.tile(np.eye(3), (31, 18, 1, 1))

# The array that is replaced, by what (None takes it out), and the expectation and the finding that the error states.
WRONG = {
    "no names": ("joint_names", None, "an array 'joint_names'", "the arrays fps, offsets"),
    "names of bytes": ("joint_names", np.array([b"a"]), "a plain .npy array", "the header"),
    "an empty name": ("joint_names", np.array(["", *"abcdefghijklmnopq"]), "printable names", "''"),
    "a name twice": ("joint_names", np.array(["a"] * 18), "a tree of joints", "joint name 'a' stands twice"),
    "too few names": ("joint_names", np.array(["a", "b"]), "shape (2,)", "shape (18,)"),
    "endless names": ("joint_names", np.array(["x" * 300]), "an array of text", "type <U300"),
    "pickled objects": ("joint_names", np.array([print, {}], object), "a plain .npy array", "the header"),
    "a parent that follows": ("parents", np.arange(18), "a tree of joints", "each joint's parent must stand before it"),
    "parents of fractions": ("parents", np.zeros(18), "an array of whole numbers", "type <f8"),
    "no matrices": ("rotation_matrices", None, "either 'rotations' or 'rotation_matrices'", "neither"),
    "both": ("rotations", np.zeros((31, 18, 4)), "either 'rotations' or 'rotation_matrices'", "rotations and"),
    "a frame missing": ("rotation_matrices", MATRIX[:-1], "shape (31, 18, 3, 3)", "shape (30, 18, 3, 3)"),
    "a scale": ("rotation_matrices", 1.1 * MATRIX, "rotation matrices without scale and shear", "0.21 at frame 0"),
    "a mirror": ("rotation_matrices", -MATRIX, "rotation matrices that do not mirror", "-1 at frame 0, joint 0"),
    "nan": ("root_positions", np.full((31, 3), np.nan), "finite numbers up to 1e+09", "nan at [0, 0]"),
    "a signalling nan": (
        "root_positions",
        np.full((31, 3), 0x7F800001, np.uint32).view(np.float32),
        "finite numbers up to 1e+09",
        "nan at [0, 0]",
    ),
    "far away": ("root_positions", np.full((31, 3), 1e12), "finite numbers up to 1e+09", "1000000000000.0 at [0, 0]"),
    "no frames": ("root_positions", np.zeros((0, 3)), "1 to 200000 frames", "0 frames"),
    "a plane root": ("root_positions", np.zeros((31, 2)), "shape (any, 3)", "shape (31, 2)"),
    "no rate": ("fps", np.array(0.0), "one number from", "[0.0]"),
    "two rates": ("fps", np.array([30.0, 60.0]), "one number from", "[30.0, 60.0]"),
    "contacts without names": ("contacts", np.zeros((31, 2)), "an array 'contact_names'", "the arrays contacts, fps"),
    "complex offsets": ("offsets", np.zeros((18, 3), complex), "a plain .npy array", "the header"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_archive_is_refused_with_the_array(name, tmp_path):
    key, value, expected, found = WRONG[name]
    arrays = arrays_of(clip_files.walk())
    if value is None:
        del arrays[key]
    else:
        arrays[key] = value
    with pytest.raises(MotionFileError) as caught:
        npz.read_file(saved(tmp_path, arrays))
    assert expected in caught.value.expected
    assert found in caught.value.found
    assert caught.value.place in {*arrays, key, "rotations", "contact_names", "parents"}


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"not a zip at all", b"\x93NUMPY"])
def test_what_is_no_archive_is_refused(content, tmp_path):
    (tmp_path / "clip.npz").write_bytes(content)
    with pytest.raises(MotionFileError, match="expected an .npz archive"):
        npz.read_file(tmp_path / "clip.npz")


def replaced(folder: Path, name: str, content: bytes) -> Path:
    """A valid archive but for the bytes of one array."""
    path = folder / "clip.npz"
    source = zipfile.ZipFile(saved(folder, arrays_of(clip_files.walk()), "source.npz"))
    with source, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
        for row in source.namelist():
            target.writestr(row, content if row == f"{name}.npy" else source.read(row))
    return path


def head(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (head("{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999, 3), }"), "bytes for shape"),
        (head("{'descr': '<f8', 'fortran_order': False, 'shape': (9999999, 9999999, 99999), }"), "shape (9999999, "),
        (head("{'descr': '<f8', 'fortran_order': False, 'shape': (31, 3), }"), "744 bytes for shape (31, 3)"),
        (head("{'descr': '|O', 'fortran_order': False, 'shape': (2,), }") + pickle.dumps([print]), "the header"),
        (head("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (2,), }"), "the header"),
        (head("__import__('os').system('true')"), "the header"),
        (head(f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({'1' * 40}x"), "the header"),
        (b"\x93NUMPY\x01\x00\xff\xff{", "a header of 65535 bytes"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xff{", "a header of 4294967295 bytes"),
        (b"", "it does not begin as an .npy file"),
    ],
)
def test_a_hostile_array_is_refused(content, found, tmp_path):
    with pytest.raises(MotionFileError) as caught:
        npz.read_file(replaced(tmp_path, "root_positions", content))
    assert caught.value.place == "root_positions"
    assert found in caught.value.found


@pytest.mark.parametrize("code", [0x110000, 0xFFFFFFFF])
def test_numbers_of_no_character_are_refused(code, tmp_path):
    content = head("{'descr': '<U1', 'fortran_order': False, 'shape': (1,), }") + code.to_bytes(4, "little")
    with pytest.raises(MotionFileError, match=f"expected text, found {code:#x}"):
        npz.read_file(replaced(tmp_path, "joint_names", content))


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_compressions_without_a_bound_of_memory_are_refused(method, tmp_path):
    with (
        np.load(saved(tmp_path, arrays_of(some_motion(1, 3, 4)))) as file,
        zipfile.ZipFile(tmp_path / "other.npz", "w", method) as packed,
    ):
        for name in file.files:
            with packed.open(f"{name}.npy", "w") as part:
                np.lib.format.write_array(part, file[name])
    with pytest.raises(MotionFileError, match=f"stored or deflated data, found compression {method}"):
        npz.read_file(tmp_path / "other.npz")


def test_an_array_that_unpacks_to_too_much_is_not_unpacked(tmp_path, monkeypatch):
    bomb = head("{'descr': '<f8', 'fortran_order': False, 'shape': (2800000, 3), }") + bytes(2_800_000 * 24)
    path = replaced(tmp_path, "root_positions", bomb)
    assert path.stat().st_size < 1_000_000
    sizes, plain = [], zipfile.ZipExtFile.read
    monkeypatch.setattr(zipfile.ZipExtFile, "read", lambda file, n=-1: sizes.append(n) or plain(file, n))
    with pytest.raises(MotionFileError, match="at most 4800000 bytes, found 67200000 bytes for shape"):
        npz.read_file(path)
    assert 0 <= min(sizes) <= max(sizes) < 100_000


def test_too_many_arrays_are_refused(tmp_path):
    path = saved(tmp_path, {f"a{k}": np.zeros(1) for k in range(1001)})
    with pytest.raises(MotionFileError, match="at most 1000 arrays, found 1001"):
        npz.read_file(path)


def base() -> bytes:
    content = io.BytesIO()
    np.savez_compressed(content, **arrays_of(some_motion(1, 3, 4)))
    return content.getvalue()


BASE = base()


@given(st.data())
@settings(max_examples=400, deadline=None)
def test_damaged_archives_give_a_motion_or_a_motion_file_error(tmp_path_factory, data):
    content = bytearray(BASE)
    for _ in range(data.draw(st.integers(1, 5))):
        start = data.draw(st.integers(0, len(content)))
        wound = data.draw(st.binary(min_size=1, max_size=8))
        kind = data.draw(st.integers(0, 2))
        if kind == 0:
            content[start : start + len(wound)] = wound
        elif kind == 1:
            del content[start : start + len(wound)]
        else:
            del content[start:]
    path = tmp_path_factory.getbasetemp() / "damaged.npz"
    path.write_bytes(bytes(content))
    try:
        assert isinstance(npz.read_file(path).motion, Motion)
    except MotionFileError as err:
        assert str(path) in str(err)  # noqa: PT017  # both outcomes are right


def test_damaged_headers_give_a_motion_or_a_motion_file_error(tmp_path):
    rng, refusals = np.random.default_rng(0), 0
    part = io.BytesIO()
    np.lib.format.write_array(part, clip_files.walk().root)
    for _ in range(400):
        content = bytearray(part.getvalue())
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(128))
            content[at : at + int(rng.integers(3))] = rng.choice(
                [b"9", b"(", b"'", b",", b"\xff", b"0", b"<", b"U", b""]
            )
        try:
            assert isinstance(npz.read_file(replaced(tmp_path, "root_positions", bytes(content))).motion, Motion)
        except MotionFileError:
            refusals += 1
    assert 100 < refusals < 400
