from __future__ import annotations

import tomllib

import numpy as np
import pytest

from tests.verbs import walker
from verbs.motion import Motion
from verbs.proposal import cycles, unannotated
from verbs.proposal.clips import clip_of, read_clip
from verbs.proposal.features import align, features_of
from verbs.proposal.keytimes import from_annotated, in_order

AGREED_S = 0.066


@pytest.fixture(scope="module")
def annotated(mocap):
    """Clips, keytimes, effector and whether it loops, of a captured set."""

    def load(name):
        table = tomllib.loads((mocap / name / "verb.toml").read_text())
        clips = [read_clip(mocap / name / row["file"]) for row in table["example"]]
        effector = clips[0].motion.skeleton.index(table["effector"])
        return clips, [tuple(row["keytimes"]) for row in table["example"]], effector, table["looping"]

    return load


@pytest.mark.parametrize("name", ["reach", "punch", "kick", "jump", "locomotion"])
def test_keytimes_from_one_annotated_clip_agree_with_the_annotated_ones(annotated, name):
    clips, keytimes, effector, looping = annotated(name)
    features = features_of(clips)
    gaps, sure = [], []
    for a in range(len(clips)):
        found = from_annotated(clips, features, {a: keytimes[a]}, effector=effector, cyclic=looping)
        assert found[a].times == keytimes[a]
        for i, own in enumerate(found):
            assert np.diff(own.times).min() > 0.0
            assert all(0.0 <= c <= 1.0 for c in own.confidence)
            if i != a:
                gaps += list(np.abs(np.subtract(own.times, keytimes[i]))[1:-1])
                sure += list(own.confidence[1:-1])
    assert np.median(gaps) <= AGREED_S
    assert len(set(np.round(sure, 6))) > 1


def test_several_annotated_clips_agree_better_than_one(annotated):
    clips, keytimes, effector, looping = annotated("locomotion")
    features = features_of(clips)

    def mean(chosen):
        found = from_annotated(clips, features, {a: keytimes[a] for a in chosen}, effector=effector, cyclic=looping)
        rest = [i for i in range(len(clips)) if i not in chosen]
        return np.mean([np.abs(np.subtract(found[i].times, keytimes[i]))[1:-1] for i in rest])

    alone = np.mean([mean([a]) for a in range(1, 17, 2)])
    assert np.mean([mean([a, a + 1, a + 2, a + 3]) for a in range(1, 16, 3)]) < 0.9 * alone


@pytest.mark.parametrize(("name", "limit"), [("reach", 0.066), ("punch", 0.033), ("kick", 0.033)])
def test_the_apex_is_found_without_annotation(annotated, name, limit):
    clips, keytimes, effector, _ = annotated(name)
    found = [unannotated.of_position(clip, effector) for clip in clips]
    assert np.median([abs(own.times[1] - marks[1]) for own, marks in zip(found, keytimes, strict=True)]) <= limit


def test_crouch_and_landing_are_found_without_annotation(annotated):
    clips, keytimes, _, _ = annotated("jump")
    found = [unannotated.of_jump(clip) for clip in clips]
    gaps = [np.abs([own.times[1] - m[1], own.times[3] - m[2]]) for own, m in zip(found, keytimes, strict=True)]
    assert np.median(gaps) <= 0.1


def test_files_of_one_cycle_are_recognised_and_their_strides_counted(annotated):
    clips, keytimes, _, _ = annotated("locomotion")
    assert all(cycles.is_cycle(clip) for clip in clips)
    assert [cycles.strides(clip)[0] for clip in clips] == [0, *[2] * 18]  # the first is an idle
    found = [unannotated.of_cycle(clip, 2) for clip in clips]
    assert np.median([np.abs(np.subtract(f.times, k))[1:-1] for f, k in zip(found, keytimes, strict=True)]) <= 0.066


def repeated(cycle: Motion, times: int, *, tail: int = 7) -> Motion:
    """Cycles of a walk one after the other, with part of one more."""
    advance = cycle.root[-1] - cycle.root[0]
    roots = [cycle.root[:-1] + k * advance for k in range(times)] + [cycle.root[:tail] + times * advance]
    rotations = [cycle.rotations[:-1]] * times + [cycle.rotations[:tail]]
    return Motion(cycle.skeleton, cycle.fps, np.concatenate(roots), np.concatenate(rotations))


@pytest.mark.parametrize("seconds", [0.9, 1.0, 1.3])
def test_a_long_walk_is_cut_to_one_closed_cycle(tmp_path, seconds):
    cycle = walker.walk(1.2 / seconds, cycle_s=seconds)
    clip = clip_of(tmp_path / "walk.bvh", repeated(cycle, 5))
    assert not cycles.is_cycle(clip)
    length, clear = cycles.period(clip)
    assert length == pytest.approx(seconds, abs=0.02)
    assert clear > 0.9
    cut = cycles.cut_cycle(clip)
    assert cut.clip.duration_s == pytest.approx(seconds, abs=0.02)
    assert cut.seam.most_m < 0.01
    ends = cut.clip.motion.rotations[[0, -1]]
    assert np.abs(np.sum(ends[0] * ends[1], axis=-1)).min() == pytest.approx(1.0, abs=1e-9)
    assert cut.clip.motion.root[-1, 1] == pytest.approx(cut.clip.motion.root[0, 1])
    assert cycles.is_cycle(cut.clip)


def test_what_does_not_repeat_is_not_cut(annotated):
    clips, _, _, _ = annotated("punch")
    assert all(cycles.cut_cycle(clip) is None for clip in clips[:5])


def test_long_clips_are_aligned_with_bounded_memory(tmp_path):
    cycle = walker.walk(1.2)
    long = clip_of(tmp_path / "long.bvh", repeated(cycle, 170))
    short = clip_of(tmp_path / "short.bvh", repeated(cycle, 100))
    features = features_of([long, short])
    assert len(long.motion) > 10_000
    assert max(len(one.rows) for one in features) <= 502
    path = align(*features)
    assert path.first[-1] == pytest.approx(long.duration_s)
    assert path.second[-1] == pytest.approx(short.duration_s)


def test_keytimes_are_kept_apart_and_inside_the_clip():
    assert in_order((0.0, 1.0, 0.9, 2.5), 2.0) == pytest.approx((0.0, 1.0, 1.02, 2.0))
    assert in_order((0.0, 1.99, 1.99, 2.0), 2.0) == pytest.approx((0.0, 1.96, 1.98, 2.0))
