"""One function reads every format, by the ending of the file."""

from __future__ import annotations

import numpy as np
import pytest

from tests.verbs import clip_files
from verbs.errors import MotionFileError, UnknownName
from verbs.io import bvh, motion_files


def test_a_bvh_file_is_read_with_its_report(tmp_path):
    path = clip_files.write_bvh(
        tmp_path / "Walk.BVH", clip_files.on_the_ground(clip_files.body_bones(), clip_files.ground())
    )
    file = motion_files.read(path, unit="cm")
    plain = bvh.read(path, unit="cm")
    np.testing.assert_array_equal(file.motion.root, plain.root)
    assert (file.report.format, file.report.clips, file.report.clip) == ("bvh", ("",), 0)
    assert file.report.folded[0].name == "Reference"


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
