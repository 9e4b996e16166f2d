"""One function reads every format, by the ending of the file."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from tests.verbs import clip_files
from tests.verbs.gltf_files import body_file
from verbs.cli.pose import FORMATS
from verbs.errors import MotionFileError, UnknownName
from verbs.io import bvh, motion_files, npz
from verbs.io.files import file_content


def test_a_bvh_file_is_read_with_its_report(tmp_path):
    path = clip_files.write_bvh(
        tmp_path / "Walk.BVH", clip_files.on_the_ground(clip_files.body_bones(), clip_files.ground())
    )
    file = motion_files.read(path, unit="cm")
    plain = bvh.read(path, unit="cm")
    np.testing.assert_array_equal(file.motion.root, plain.root)
    assert (file.report.format, file.report.clips, file.report.clip) == ("bvh", ("",), 0)
    assert file.report.folded[0].name == "Reference"


def test_a_small_file_takes_little_memory(tmp_path):
    path = clip_files.write_bvh(tmp_path / "a.bvh", clip_files.body_bones(frames=2))
    tracemalloc.start()
    try:
        assert file_content(path) == path.read_bytes()
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", ["clip.fbx", "clip", "clip.bvh.txt"])
def test_another_ending_is_refused_with_the_known_ones(name, tmp_path):
    (tmp_path / name).write_text("x")
    with pytest.raises(MotionFileError, match=r"expected a file that ends in \.bvh"):
        motion_files.read(tmp_path / name)


def test_an_unknown_unit_is_refused(tmp_path):
    with pytest.raises(UnknownName, match="unknown unit 'yd'"):
        motion_files.read(tmp_path / "a.bvh", unit="yd")


def test_a_bvh_file_has_no_choice_of_clips(tmp_path):
    path = clip_files.write_bvh(tmp_path / "a.bvh", clip_files.body_bones())
    with pytest.raises(MotionFileError, match="a BVH file holds one motion, found clip 'walk'"):
        motion_files.read(path, clip="walk")


def test_the_clips_of_a_file_are_listed(tmp_path):
    source = body_file()
    source.animation()
    assert motion_files.clip_names(source.write(tmp_path / "a.glb")) == ("walk", "animation 1")
    path = clip_files.write_bvh(tmp_path / "a.bvh", clip_files.body_bones())
    assert motion_files.clip_names(path) == motion_files.read(path).report.clips == ("",)


@pytest.mark.parametrize("name", ["clip.glb", "clip.gltf", "clip.npz"])
def test_every_format_is_read_by_its_ending(name, tmp_path):
    if name == "clip.npz":
        npz.write(clip_files.walk(), tmp_path / name)
    else:
        body_file().write(tmp_path / name)
    file = motion_files.read(tmp_path / name)
    assert file.report.format == ("npz" if name == "clip.npz" else "gltf")
    assert file.motion.skeleton.names[0] == "Hips"
    with pytest.raises(MotionFileError, match="clip 'run'|animation 'run'"):
        motion_files.read(tmp_path / name, clip="run")


@pytest.mark.parametrize("ending", [".bvh", ".glb", ".npz"])
def test_every_format_that_is_written_and_read_keeps_the_motion(ending, tmp_path):
    motion = clip_files.walk()
    motion_files.write(motion, tmp_path / f"a{ending}")
    found = motion_files.read(tmp_path / f"a{ending}").motion
    assert found.skeleton.names == motion.skeleton.names
    np.testing.assert_allclose(found.root, motion.root, atol=1e-6)
    np.testing.assert_allclose(np.abs((found.rotations * motion.rotations).sum(axis=-1)), 1.0, atol=1e-6)


def test_the_formats_of_the_command_are_those_that_are_written():
    assert tuple(dict.fromkeys(motion_files.WRITTEN.values())) == FORMATS


def test_another_ending_is_not_written(tmp_path):
    with pytest.raises(MotionFileError, match=r"ends in \.bvh or \.glb or"):
        motion_files.write(clip_files.walk(), tmp_path / "a.fbx")
    with pytest.raises(UnknownName, match="unknown format 'fbx'; known: bvh, glb, vrma, npz, usd"):
        motion_files.dump(clip_files.walk(), "fbx")
