from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest

from verbs.conventions import MAX_FRAMES
from verbs.errors import SkeletonMismatch
from verbs.motion import Motion
from verbs.skeleton import Skeleton

SKELETON = Skeleton(("Hips", "Spine"), np.array([-1, 0]), np.zeros((2, 3)))


def motion(frames: int = 4, **changes) -> Motion:
    rotations = np.zeros((frames, 2, 4))
    rotations[..., 3] = 1.0
    fields = {"skeleton": SKELETON, "fps": 30.0, "root": np.zeros((frames, 3)), "rotations": rotations}
    return Motion(**(fields | changes))


def test_a_motion_lasts_from_its_first_to_its_last_frame():
    assert len(motion(31)) == 31
    assert motion(31).duration_s == pytest.approx(1.0)
    assert motion(1).duration_s == 0.0


def test_a_motion_is_frozen_and_survives_pickling():
    with pytest.raises(dataclasses.FrozenInstanceError):
        motion().fps = 60.0
    assert len(pickle.loads(pickle.dumps(motion()))) == 4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"root": np.zeros((0, 3)), "rotations": np.zeros((0, 2, 4))}, f"1 to {MAX_FRAMES} frames, not 0"),
        ({"root": np.zeros((5, 3))}, r"2 joints and 5 frames, but root \(5, 3\) and rotations \(4, 2, 4\)"),
        ({"root": np.zeros((4, 2))}, r"root \(4, 2\)"),
        ({"rotations": np.zeros((4, 3, 4))}, r"rotations \(4, 3, 4\)"),
        ({"fps": 0.0}, "above zero, not 0.0"),
        ({"fps": -30.0}, "above zero, not -30.0"),
        ({"fps": np.nan}, "above zero, not nan"),
        ({"fps": np.inf}, "above zero, not inf"),
        ({"root": np.full((4, 3), np.nan)}, "values must be finite"),
        ({"rotations": np.full((4, 2, 4), np.inf)}, "values must be finite"),
    ],
)
def test_a_wrong_motion_says_what_is_wrong(changes, message):
    with pytest.raises(SkeletonMismatch, match=message):
        motion(**changes)


def test_too_many_frames_are_refused():
    with pytest.raises(SkeletonMismatch, match=f"not {MAX_FRAMES + 1}"):
        motion(MAX_FRAMES + 1)
