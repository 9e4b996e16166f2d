import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.verbs import broken_clips as broken
from verbs.clips import mends, paths, resample
from verbs.clips.orientation import heading
from verbs.clips.reports import Mend, toml_text
from verbs.errors import OutOfRange, UnknownName
from verbs.io import bvh

WRIST, ARM = "RightHand", "RightForeArm"


def found(motion, kind):
    return [report for report in mends.find(motion) if report.mend.kind == kind]


def mended(motion, kind, **options):
    return mends.apply(motion, [Mend(kind, options=options)])


def kinds(motion):
    return {report.mend.kind for report in mends.find(motion)} - {"idle"}


@pytest.mark.parametrize("verb", ["reach", "punch", "kick", "jump", "walk", "jog", "lift", "mood", "board", "arm3"])
def test_authored_clips_are_clean(verb):
    for file in sorted((broken.LIBRARY / verb).glob("*.bvh"))[:8]:
        assert not kinds(bvh.read(file)), file


@pytest.mark.parametrize("verb", ["punch", "kick", "reach", "reach_left", "jump", "locomotion"])
def test_captured_clips_are_clean(mocap, verb):
    files = sorted((mocap / verb).glob("*.bvh"))
    assert files
    for file in files:
        assert not kinds(bvh.read(file)), file


@pytest.mark.parametrize("frames", [24, 60])
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.6, 0.0, 0.8)])
def test_a_spin_is_found_and_unwound(frames, axis):
    clean = broken.clean()
    spun = broken.spin(clean, WRIST, 60, 60 + frames, axis=axis)
    assert broken.apart_deg(spun, clean) > 150
    (report,) = found(spun, "spin")
    assert report.mend.joint == WRIST
    assert report.mend.start_s == pytest.approx(1.0, abs=0.12)
    assert report.mend.end_s == pytest.approx(1.0 + frames / 60, abs=0.12)
    assert report.figure == pytest.approx(360, abs=60)
    result = mended(spun, "spin").motion
    assert broken.apart_deg(result, clean) < 20
    first, last = round(60 * report.mend.start_s), round(60 * report.mend.end_s)
    joint = clean.skeleton.index(WRIST)
    outside = np.r_[: first + 1, last : len(clean)]
    assert np.array_equal(result.rotations[outside], spun.rotations[outside])
    others = np.arange(len(clean.skeleton)) != joint
    assert np.array_equal(result.rotations[:, others], spun.rotations[:, others])
    assert not found(result, "spin")


def test_two_spins_of_one_joint_and_one_of_another():
    clean = broken.clean()
    spun = broken.spin(broken.spin(clean, WRIST, 20, 50), WRIST, 90, 130, turns=-1.0)
    spun = broken.spin(spun, "LeftHand", 60, 80, axis=(0.0, 1.0, 0.0))
    reports = found(spun, "spin")
    assert sorted(report.mend.joint for report in reports) == ["LeftHand", WRIST, WRIST]
    only = mends.apply(spun, [Mend("spin", WRIST)])
    assert [report.mend.joint for report in only.reports] == [WRIST, WRIST]
    assert broken.apart_deg(mended(spun, "spin").motion, clean) < 20


def test_spins_in_captured_clips_are_found_and_nothing_else(mocap):
    rng = np.random.default_rng(5)
    files = sorted(mocap.glob("*/*.bvh"))
    for k in range(40):
        clip = bvh.read(files[rng.integers(len(files))])
        length = int(rng.uniform(0.15, min(2.0, 0.6 * clip.duration_s)) * clip.fps)
        first, axis = int(rng.integers(2, len(clip) - length - 2)), rng.standard_normal(3)
        joint = ("RightHand", "LeftForeArm", "Head")[k % 3]
        bad = broken.spin(clip, joint, first, first + length, axis=axis / np.linalg.norm(axis))
        (report,) = mends.find(bad, ["gap", "spike", "spin"])
        assert (report.mend.kind, report.mend.joint) == ("spin", joint)
        assert not found(mended(bad, "spin").motion, "spin")


def test_a_root_may_turn_around():
    assert not found(broken.spin(broken.clean(), "Hips", 20, 80, axis=(0.0, 1.0, 0.0)), "spin")


def test_a_stated_stretch_is_unwound():
    spun = broken.spin(broken.clean(), WRIST, 60, 90)
    done = mends.apply(spun, [Mend("spin", WRIST, 1.0, 1.5)])
    assert broken.apart_deg(done.motion, broken.clean()) < 20


@pytest.mark.parametrize("verb", ["reach", "punch"])
@pytest.mark.parametrize("frames", [1, 2, 3])
@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_spikes_are_found_and_interpolated(verb, frames, fps):
    clean = broken.clean(verb, fps=fps)
    at = round(fps)
    spiked = broken.spike(clean, "Head", at, frames=frames)
    (report,) = found(spiked, "spike")
    assert (report.mend.joint, report.mend.start_s) == ("Head", pytest.approx(1.0))
    assert report.figure == pytest.approx(40, abs=4)
    result = mended(spiked, "spike").motion
    assert broken.apart_deg(result, clean) < 2
    assert np.array_equal(np.delete(result.rotations, range(at, at + frames), 0),
                          np.delete(spiked.rotations, range(at, at + frames), 0))  # fmt: skip


def test_flips_and_jumps_of_the_root_are_found():
    clean = broken.clean()
    bad = broken.root_spike(broken.flip(clean, WRIST, 40), 80)
    reports = found(bad, "spike")
    assert [(report.mend.joint, report.unit) for report in reports] == [("Hips", "mm"), (WRIST, "deg")]
    assert reports[0].figure == pytest.approx(300, abs=3)
    result = mended(bad, "spike").motion
    assert broken.apart_deg(result, clean) < 3
    assert broken.apart_m(result, clean) < 0.005


def test_gaps_are_found_and_interpolated():
    clean = broken.clean()
    for joint in (ARM, None):
        bad = broken.gap(clean, joint, 40, 48)
        (report,) = found(bad, "gap")
        assert report.mend.joint == joint
        assert (report.mend.start_s, report.mend.end_s) == (pytest.approx(40 / 60, abs=1e-4), pytest.approx(0.8))
        assert report.figure == pytest.approx(9 / 60)
        assert broken.apart_deg(bad, clean) > 3 * broken.apart_deg(mended(bad, "gap").motion, clean)
        assert broken.apart_deg(mended(bad, "gap").motion, clean) < 1.5


def test_missing_rotations_are_interpolated():
    clean = broken.clean()
    (report,) = found(broken.missing(clean, ARM, 30, 33), "gap")
    assert (report.mend.joint, report.mend.start_s) == (ARM, 0.5)
    assert broken.apart_deg(mended(broken.missing(clean, ARM, 30, 33), "gap").motion, clean) < 0.5


def test_a_long_gap_is_only_reported():
    bad = broken.gap(broken.clean(), ARM, 30, 75)
    (report,) = found(bad, "gap")
    assert not report.proposed
    assert np.array_equal(mended(bad, "gap").motion.rotations, bad.rotations)
    forced = mends.apply(bad, [report.mend])
    assert broken.apart_deg(forced.motion, broken.clean()) < broken.apart_deg(bad, broken.clean())


def test_a_held_pose_is_no_gap():
    motion = broken.idle(broken.clean(), 60, 60)
    assert not found(motion, "gap")


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_jitter_is_found_and_filtered(fps):
    clean = broken.clean(fps=fps)
    bad = broken.jitter(clean, "Head", degrees=1.0)
    (report,) = found(bad, "jitter")
    assert report.mend.joint == "Head"
    share = np.sqrt(max(0.0, 1.0 - 8.0 / (0.5 * fps)))  # of white noise above the cut-off
    assert report.figure == pytest.approx(np.sqrt(3) * share, rel=0.25)
    assert "Butterworth" in report.done
    before, after = (broken.apart_deg(one, clean) for one in (bad, mended(bad, "jitter").motion))
    assert after < 0.85 * before
    assert not found(mended(bad, "jitter").motion, "jitter")


def test_jitter_of_the_root_is_filtered_at_a_stated_frequency():
    clean = broken.clean()
    bad = broken.root_jitter(clean)
    assert [(report.mend.joint, report.unit) for report in found(bad, "jitter")] == [("Hips", "mm")]
    done = mended(bad, "jitter", cutoff_hz=4.0)
    away, left = (np.linalg.norm(one.root - clean.root, axis=1) for one in (bad, done.motion))
    assert np.sqrt(np.mean(left**2)) < 0.6 * np.sqrt(np.mean(away**2))
    assert "at 4 Hz" in done.reports[0].done
    with pytest.raises(OutOfRange, match="below 30 Hz"):
        mended(bad, "jitter", cutoff_hz=31.0)


@pytest.mark.parametrize(("head", "tail"), [(1, 0), (0, 1), (2, 3), (15, 0)])
def test_calibration_poses_at_the_ends_are_cut_off(head, tail):
    clean = broken.clean()
    bad = broken.calibrated(clean, head, tail)
    (report,) = found(bad, "cut")
    done = mended(bad, "cut")
    assert report.figure == pytest.approx((head + tail) / clean.fps)
    assert (done.start_s, done.end_s) == pytest.approx(
        (head / clean.fps, head / clean.fps + clean.duration_s), abs=1e-6
    )
    np.testing.assert_allclose(paths.positions(done.motion), paths.positions(clean), atol=1e-9)
    assert not found(done.motion, "cut")
    table = mends.apply(bad, [report.mend]).motion
    np.testing.assert_array_equal(table.rotations, done.motion.rotations)


def test_a_long_part_beside_a_cut_is_left():
    clean = broken.clean()
    assert not found(broken.calibrated(clean, len(clean)), "cut")
    with pytest.raises(OutOfRange, match="no parameters"):
        mended(clean, "cut", speed=1.0)


def test_idle_heads_and_tails_are_trimmed():
    clean = broken.clean()
    bad = broken.idle(clean, 120, 90)
    (report,) = found(bad, "idle")
    done = mended(bad, "idle")
    assert 120 / 60 - 0.3 < done.start_s < 120 / 60 + 0.7
    assert (done.start_s, done.end_s) == (report.mend.start_s, report.mend.end_s)
    assert len(mends.apply(bad, [report.mend]).motion) == len(done.motion)
    first = round(done.start_s * 60)
    assert np.array_equal(done.motion.rotations, bad.rotations[first : first + len(done.motion)])
    assert mended(bad, "idle", margin=0.5).start_s == pytest.approx(done.start_s - 0.25, abs=0.02)
    assert not found(mended(broken.idle(clean, 0, 0), "idle").motion, "idle")
    still = resample.trim(broken.idle(clean, 200, 0), 0.0, 3.0)
    assert not found(still, "idle")


@pytest.mark.parametrize("height", [-0.9, 0.2])
def test_the_ground_is_found(height):
    clean = broken.clean("jump")
    bad = broken.moved(clean, y=height)
    (report,) = found(bad, "ground")
    assert report.figure == pytest.approx(1000 * abs(height), abs=30)
    assert broken.apart_m(mended(bad, "ground").motion, clean) < 0.03
    stated = mended(bad, "ground", height=height).motion
    assert broken.apart_m(stated, clean) < 1e-12


def test_a_skeleton_without_feet_stands_on_its_lowest_joint():
    motion = broken.moved(broken.clean("arm3"), y=2.0)
    assert not found(motion, "ground")
    lowest = broken.positions(mended(motion, "ground").motion)[..., 1]
    assert abs(np.percentile(lowest.min(axis=1), 20)) < 0.3


def test_start_and_heading():
    clean = mended(mended(broken.clean(), "heading").motion, "start").motion
    assert heading(clean) == pytest.approx(0.0, abs=1e-12)
    bad = broken.turned(broken.moved(clean, 1.0, 0.0, -2.0), 120.0)
    assert np.degrees(heading(bad)) == pytest.approx(120.0)
    assert [report.mend.kind for report in mends.find(bad, ("heading", "start"))] == ["heading", "start"]
    done = mends.apply(bad, [Mend("start"), Mend("heading")])
    assert broken.apart_m(done.motion, clean) < 1e-12
    assert [report.mend.kind for report in done.reports] == ["heading", "start"]
    given_angle = mends.apply(bad, [Mend("heading", options={"degrees": 120.0}), Mend("start")])
    assert broken.apart_m(given_angle.motion, clean) < 1e-12
    with pytest.raises(OutOfRange, match="give degrees"):
        mended(broken.clean("arm3"), "heading")


def test_heading_needs_no_local_axis():
    """Hips whose local frame is rotated: the same bones, another X, Y and Z."""
    clean = broken.turned(broken.clean(), 70.0)
    frame = np.array([0.5, 0.5, 0.5, 0.5])
    assert heading(broken.local_frame(clean, frame)) == pytest.approx(heading(clean), abs=1e-9)


def test_all_faults_at_once_are_mended_in_their_order():
    clean = mended(broken.clean(), "start").motion
    bad = broken.gap(broken.spike(broken.spin(clean, WRIST, 60, 90), "Head", 30), ARM, 40, 46)
    bad = broken.moved(bad, 0.5, 0.4, 0.0)
    reports = [report for report in mends.find(bad) if report.mend.kind != "idle"]
    assert [report.mend.kind for report in reports] == ["gap", "spike", "spin", "ground", "start"]
    done = mends.apply(bad, [report.mend for report in reports[::-1]])
    assert [report.mend.kind for report in done.reports] == ["gap", "spike", "spin", "ground", "start"]
    assert broken.apart_deg(done.motion, clean) < 20
    again = mends.apply(bad, [report.mend for report in reports])
    assert np.array_equal(done.motion.rotations, again.motion.rotations)


def test_what_is_wrong_is_named():
    clean = broken.clean()
    with pytest.raises(UnknownName, match="unknown kind of mend 'polish'; known: gap, spike, spin"):
        mends.apply(clean, [Mend("polish")])
    with pytest.raises(UnknownName, match="unknown kind of mend"):
        mends.find(clean, ["polish"])
    with pytest.raises(UnknownName, match="unknown joint 'Nose'"):
        mends.apply(clean, [Mend("spin", "Nose")])
    with pytest.raises(OutOfRange, match="both start and end"):
        mends.apply(clean, [Mend("spin", WRIST, 1.0)])
    with pytest.raises(OutOfRange, match="give 0 ≤ from ≤ to"):
        mends.apply(clean, [Mend("idle", None, 1.0, 99.0)])
    with pytest.raises(OutOfRange, match="must not be negative"):
        mended(clean, "idle", margin=-1.0)


def test_a_report_is_a_table_to_paste():
    (report,) = found(broken.spin(broken.clean(), WRIST, 60, 90), "spin")
    text = toml_text(report.mend, "clip 1")
    assert text.startswith('[[mend]]\nkind = "spin"\nexample = "clip 1"\njoint = "RightHand"\nstart = ')
    assert report.row()["unit"] == "deg"


@given(st.integers(4, 40), st.integers(1, 3), st.floats(20.0, 170.0), st.sampled_from(["Head", WRIST, "LeftArm"]))
def test_any_spike_is_mended(frame, frames, degrees, joint):
    clean = broken.clean()
    bad = broken.spike(clean, joint, frame, degrees=degrees, frames=frames)
    result = mended(bad, "spike").motion
    assert broken.apart_deg(result, clean) < 4


@given(st.integers(1, 400), st.integers(1, 400), st.sampled_from([24.0, 29.97, 30.0, 60.0, 120.0, 240.0]))
def test_a_proposed_trim_survives_its_table(head, tail, fps):
    """Times are rounded in the table; the same frames are kept."""
    clean = resample.resample(broken.clean(), fps)
    bad = broken.idle(clean, head, tail)
    for report in found(bad, "idle"):
        table = tomllib.loads(toml_text(report.mend, "a"))["mend"][0]
        kept = mends.apply(bad, [Mend("idle", None, table["start"], table["end"])]).motion
        assert np.array_equal(kept.rotations, mended(bad, "idle").motion.rotations)


@given(st.integers(1, 60), st.floats(0.0, 0.3))
def test_short_clips_never_fail(frames, shake):
    clean = resample.trim(broken.clean(), 0.0, (frames - 1) / 60)
    bad = broken.root_jitter(broken.jitter(clean, WRIST, degrees=100 * shake), metres=shake)
    for report in mends.find(bad):
        mends.apply(bad, [report.mend])
