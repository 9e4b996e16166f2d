import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.verbs import broken_clips as broken
from verbs.clips.resample import resample, trim
from verbs.errors import OutOfRange
from verbs.kernels import quat
from verbs.motion import Motion


def same(one, other):
    return np.array_equal(one.root, other.root) and np.array_equal(one.rotations, other.rotations)


@given(st.integers(2, 5))
def test_a_whole_multiple_keeps_every_frame(factor):
    clean = broken.clean(fps=30.0)
    fine = resample(clean, 30.0 * factor)
    assert len(fine) == factor * (len(clean) - 1) + 1
    assert same(resample(fine, 30.0), clean)


@given(st.floats(20.0, 240.0))
def test_any_rate_keeps_the_motion(fps):
    clean = broken.clean()
    there = resample(clean, fps)
    assert there.fps == fps
    assert clean.duration_s - 1 / fps < there.duration_s <= clean.duration_s + 1e-9
    back = resample(there, 60.0)
    part = Motion(clean.skeleton, 60.0, clean.root[: len(back)], clean.rotations[: len(back)])
    inside = slice(None, -3)  # the last frames are past the last sample
    assert np.abs(broken.positions(back)[inside] - broken.positions(part)[inside]).max() < 0.02 * (60 / fps) ** 2 + 2e-3
    assert np.allclose(np.linalg.norm(there.rotations, axis=-1), 1.0)


@given(st.integers(0, 60), st.integers(0, 60))
def test_trimming_on_frames_copies_them(first, count):
    clean = broken.clean()
    part = trim(clean, first / 60, (first + count) / 60)
    assert len(part) == count + 1
    assert np.array_equal(part.rotations, clean.rotations[first : first + count + 1])
    assert same(trim(trim(clean, first / 60, 2.0), 0.0, count / 60), part)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_trimming_between_frames_interpolates(start, length):
    clean = broken.clean()
    part = trim(clean, start, start + length)
    assert part.duration_s <= length + 1e-6
    assert part.duration_s > length - 1 / 60 - 1e-6
    fine = resample(clean, 6000.0)
    nearest = np.round((start + np.arange(len(part)) / 60) * 6000).astype(int)
    assert np.abs(broken.positions(part) - broken.positions(fine)[nearest]).max() < 2e-3


def test_a_sign_change_of_a_quaternion_does_not_matter():
    clean = broken.clean(fps=30.0)
    signs = np.where(np.arange(len(clean)) % 2, -1.0, 1.0)[:, None, None]
    other = Motion(clean.skeleton, 30.0, clean.root, clean.rotations * signs)
    turn = quat.mul(quat.conjugate(resample(clean, 60.0).rotations), resample(other, 60.0).rotations)
    assert np.abs(quat.log(turn)).max() < 1e-9


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_short_clips(frames):
    clean = trim(broken.clean(), 0.0, (frames - 1) / 60)
    assert len(clean) == frames
    assert len(resample(clean, 120.0)) == 2 * frames - 1
    assert same(trim(clean, 0.0, clean.duration_s), clean)


def test_what_is_out_of_range_is_named():
    clean = broken.clean()
    for start, end in ((-0.1, 1.0), (1.0, 0.5), (0.0, 99.0), (np.nan, 1.0)):
        with pytest.raises(OutOfRange, match="the length of the motion"):
            trim(clean, start, end)
    for fps in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(OutOfRange, match="above 0"):
            resample(clean, fps)
    with pytest.raises(OutOfRange, match="at most 200000"):
        resample(clean, 1e6)
