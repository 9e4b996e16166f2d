"""Looping verbs whose cycles rise or fall: a walk on an inclined plane, made by tilting a walk on level ground."""

from dataclasses import replace

import numpy as np
import pytest

from tests.verbs import walker
from verbs.authoring.fit import build
from verbs.errors import SourceError
from verbs.io import artifact
from verbs.kernels import quat
from verbs.motion import Motion
from verbs.quality import foot_contact
from verbs.runtime.characters import Characters
from verbs.runtime.evaluate import Evaluator
from verbs.runtime.sequence import sequence

SLOPES = {"down": -0.2, "level": 0.0, "up": 0.3}
STRIDE_M = 1.2


def tilted(motion: Motion, angle: float) -> Motion:
    """The same motion in a world that is tilted so that forward is uphill; the root starts over the origin."""
    tilt = quat.exp(np.array([-angle, 0.0, 0.0]))
    rotations = motion.rotations.copy()
    rotations[:, 0] = quat.mul(tilt, rotations[:, 0])
    root = quat.rotate(tilt, motion.root)
    uphill = quat.rotate(tilt, np.array([0.0, 0.0, 1.0]))
    return Motion(motion.skeleton, motion.fps, root - uphill * root[0, 2] / uphill[2], rotations)


def built(folder, *, climbing=True, slopes=SLOPES):
    motions = {name: tilted(walker.walk(STRIDE_M), angle) for name, angle in slopes.items()}
    more = "climbing = true" if climbing else ""
    return build(walker.source(folder / "figure", motions, looping=True, more=more))


@pytest.fixture(scope="module")
def hill(tmp_path_factory):
    return built(tmp_path_factory.mktemp("hill")).verb


def rise(angle: float) -> float:
    return STRIDE_M * np.sin(angle)


@pytest.mark.parametrize(("example", "angle"), list(enumerate(SLOPES.values())))
def test_each_cycle_starts_where_the_last_one_ended_in_height_too(hill, example, angle):
    evaluator = Evaluator(hill)
    phases = np.array([0.0, 0.4, 1.0, 1.4, 5.0])
    poses = evaluator.pose(hill.values[example : example + 1], phase=phases, plant=False)
    root = tilted(walker.walk(STRIDE_M), angle).root
    np.testing.assert_allclose(np.diff(poses.root[[0, 2, 4], 1]), np.array([1, 4]) * rise(angle), atol=1e-6)
    np.testing.assert_allclose(poses.root[1, 1:], root[24, 1:], atol=2e-4)
    assert poses.root[3, 1] - poses.root[1, 1] == pytest.approx(rise(angle), abs=1e-6)
    whole = sequence(evaluator, hill.values[example : example + 1], 50.0, cycles=2)
    np.testing.assert_allclose(np.diff(whole.root[[0, 50, 100], 1]), rise(angle), atol=1e-6)


def test_a_blend_climbs_by_the_mean_and_does_not_move_level_verbs(hill, tmp_path):
    poses = Evaluator(hill).pose(np.array([[1.5]]), phase=np.array([0.0, 3.0]))
    weights = poses.blend.weights[0]
    expected = 3 * sum(w * rise(angle) for w, angle in zip(weights, SLOPES.values(), strict=True))
    assert np.diff(poses.root[:, 1])[0] == pytest.approx(expected, abs=1e-6)
    flat = built(tmp_path, climbing=False)
    assert not flat.verb.strides[..., 3].any()
    assert len(flat.warnings) == 2, "the cycles of both slopes do not close"


def test_contacts_of_a_slope_are_those_of_level_ground(hill):
    known = hill.contacts
    for example in (0, 2):
        np.testing.assert_allclose(known.heights[example], known.heights[1], atol=1e-4)
        np.testing.assert_allclose(known.values[:, example], known.values[:, 1], atol=1e-6)
    for one in foot_contact.by_example(Evaluator(hill), known):
        assert one.stances == 6
        assert one.max_m < 0.01
        assert one.penetration_m < 1e-3
    middle = foot_contact.slides(Evaluator(hill), known, np.array([[1.5]]))
    assert middle.penetration_m < 0.01, "the ground under a blend is inclined too"


def test_an_artifact_keeps_rises_and_one_without_them_is_level(hill, tmp_path):
    artifact.save(hill, tmp_path / "hill.verb")
    np.testing.assert_array_equal(artifact.load(tmp_path / "hill.verb").strides, hill.strides)
    level = hill.strides.copy()
    level[..., 3] = 0.0
    artifact.save(replace(hill, strides=level), tmp_path / "level.verb")
    assert b'"rises"' not in (tmp_path / "level.verb").read_bytes()
    np.testing.assert_array_equal(artifact.load(tmp_path / "level.verb").strides, level)


def test_a_character_climbs_walks_back_down_and_keeps_its_height_in_a_switch(hill):
    people = Characters(Evaluator(hill))
    slot = people.add(hill.values[2], half_life_s=0.0)
    heights = [people.step(np.array([slot]), 1 / 50).root[0, 1] for _ in range(101)]
    assert heights[50] - heights[0] == pytest.approx(rise(0.3), abs=1e-6)
    assert heights[100] - heights[0] == pytest.approx(2 * rise(0.3), abs=1e-6)
    other = Characters(Evaluator(hill))
    after = other.go_on(people, slot, hill.values[1], phase=0.0, transition_s=0.2)
    switched = [other.step(np.array([after]), 1 / 50).root[0, 1] for _ in range(60)]
    assert np.abs(np.diff([heights[-1], *switched])).max() < 0.02, "no jump in height"
    assert switched[50] - heights[100] == pytest.approx(0.0, abs=0.05), "level walking on the height that it reached"
    people.set(slot, speed=-1.0)
    back = [people.step(np.array([slot]), 1 / 50).root[0, 1] for _ in range(100)]
    np.testing.assert_allclose(back[-1], heights[0], atol=1e-6)


def test_only_loops_climb(tmp_path):
    folder = walker.source(tmp_path / "figure", {"a": walker.stand(), "b": walker.jump()}, more="climbing = true")
    with pytest.raises(SourceError, match="climbing is for looping verbs"):
        build(folder)
