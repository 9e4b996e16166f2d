import hashlib

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, RBFInterpolator

from tests import oracle
from tests.verbs.sources import arm_source
from verbs.authoring import basis as bases
from verbs.authoring.curves import canonical_phases
from verbs.authoring.fit import build
from verbs.authoring.source import read
from verbs.errors import IllPosedVerb, SourceError
from verbs.io import artifact, bvh
from verbs.kernels import fk, quat, radial_basis
from verbs.runtime.evaluate import Evaluator
from verbs.runtime.sequence import sequence, to_motion
from verbs.verb import Verb

MOCAP = ["reach", "reach_left", "punch", "kick", "jump", "locomotion"]


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Verb:
    return build(arm_source(tmp_path_factory.mktemp("arm"))).verb


def test_a_source_may_state_the_number_of_samples(tmp_path, arm):
    folder = arm_source(tmp_path / "arm")
    text = (folder / "verb.toml").read_text()
    (folder / "verb.toml").write_text("samples = 24\n" + text)
    few = build(folder).verb
    assert few.intervals == 24 < arm.intervals
    assert few.phases[1] * 24 == round(few.phases[1] * 24), "keytimes are on samples"
    assert arm.quality["curve_error_max_m"] < few.quality["curve_error_max_m"] < 1e-3
    (folder / "verb.toml").write_text("samples = 9999\n" + text)
    with pytest.raises(SourceError, match="samples is 9999; give 1 to 8191"):
        build(folder)


@pytest.mark.parametrize("method", ["rbf", "corrected"])
def test_weights_are_cardinal_and_sum_to_one(arm, method):
    weights = Evaluator(arm).blend(arm.values, method=method).weights
    np.testing.assert_allclose(weights, np.eye(5), atol=1e-10)
    rng = np.random.default_rng(0)
    spread = Evaluator(arm).blend(rng.uniform(-3, 3, (500, 2)), method=method).weights
    np.testing.assert_allclose(spread.sum(axis=1), 1.0, atol=1e-12)


def test_basis_equals_the_plain_twin(arm):
    points = np.random.default_rng(1).uniform(0.0, 0.8, (200, 2))
    inside, _ = Evaluator(arm).clamp(points)
    found = Evaluator(arm).blend(points, method="rbf").weights
    np.testing.assert_allclose(found, oracle.weights(arm.bases["rbf"], inside), atol=1e-12)


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (radial_basis.BIHARMONIC, "linear"),
        (radial_basis.THIN_PLATE, "thin_plate_spline"),
        (radial_basis.CUBIC, "cubic"),
    ],
)
def test_radial_functions_equal_scipys(function, name):
    r = np.linspace(0, 3, 50)
    points = np.zeros((1, 1))
    ours = [radial_basis.phi(function, value) for value in r]
    # scipy's kernel matrix, seen through an interpolant of one point with no polynomial tail
    interpolant = RBFInterpolator(points + 1.0, np.ones(1), kernel=name, degree=-1, smoothing=1.0)
    np.testing.assert_allclose(ours, interpolant(r[:, None] + 1.0) / float(interpolant._coeffs[0, 0]), atol=1e-12)


def test_equal_adverbs_are_refused_by_name():
    values = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    with pytest.raises(IllPosedVerb, match="'b' and 'd'"):
        bases.cardinal(bases.chart_of(values, ("m", "m")), values, names=("a", "b", "c", "d"))


def test_scale_of_the_adverbs_does_not_matter():
    values = np.random.default_rng(2).uniform(size=(8, 3))
    one = bases.cardinal(bases.chart_of(values, ("m",) * 3), values)
    big = bases.cardinal(bases.chart_of(1e4 * values + 7, ("m",) * 3), 1e4 * values + 7)
    np.testing.assert_allclose(one.radial, big.radial, atol=1e-9)


def test_phases_of_keytimes_lie_on_keys_and_segments_are_dense_enough():
    keytimes = np.array([[0.0, 0.4, 2.0], [0.0, 1.0, 3.0], [0.0, 0.2, 0.5]])
    phases, count = canonical_phases(keytimes, 60.0)
    marks = phases * count
    np.testing.assert_allclose(marks, np.round(marks), atol=1e-9)
    assert np.all(np.diff(marks) >= np.diff(keytimes, axis=1).max(axis=0) * 60.0 - 1.0)


def test_two_builds_give_the_same_bytes(tmp_path):
    digests = set()
    for k in range(2):
        artifact.save(build(arm_source(tmp_path / str(k))).verb, tmp_path / f"{k}.verb")
        digests.add(hashlib.sha256((tmp_path / f"{k}.verb").read_bytes()).hexdigest())
    assert len(digests) == 1


def test_progress_ends_every_stage(tmp_path):
    seen = {}
    build(arm_source(tmp_path), progress=lambda stage, done, total: seen.__setitem__(stage, (done, total)))
    assert set(seen) == {"reading motions", "fitting curves", "solving the basis", "contacts", "quality"}
    assert all(done == total for done, total in seen.values())


@pytest.mark.parametrize("name", MOCAP)
def test_mocap_examples_come_back_at_their_adverbs(mocap, verb_of, name):
    """At every example's adverbs and keytimes: joints within 1e-6 m, rotations within 1e-6 rad.

    Few keytimes fall on a frame; between frames the example is a cubic spline through all frames. The end of
    a loop is its start moved on, so it is left to the test of seams.
    """
    verb = verb_of(name)
    evaluator, source, skeleton = Evaluator(verb), read(mocap / name), verb.skeleton
    for i, example in enumerate(source.examples):
        motion = bvh.read(example.file)
        kept = slice(0, -1) if verb.looping else slice(None)
        marks = np.minimum(example.keytimes[0] + verb.keytimes[i], motion.duration_s)[kept]
        frames = np.arange(len(motion)) / motion.fps
        root = CubicSpline(frames, motion.root)(marks)
        rotations, bend = quat.unroll(motion.rotations), "periodic" if verb.looping else "not-a-knot"
        if verb.looping:
            rotations[-1] = rotations[0]  # the file's last frame is its first, rounded once more
        rotations = quat.normalize(CubicSpline(frames, rotations, bc_type=bend)(marks))
        poses = evaluator.pose(verb.values[i : i + 1], phase=verb.phases[kept], plant=False)
        assert poses.blend.weights[0].sum() == pytest.approx(1.0, abs=1e-12)
        difference = quat.mul(quat.conjugate(poses.rotations), rotations)
        if verb.looping:  # steps of the walk and the turning at a mean rate are checked whole, below
            difference, root = difference[:, 1:], root * [0, 1, 0]
            poses.root[:] *= [0, 1, 0]
            rotations[:, 0] = poses.rotations[:, 0]
        _, found = evaluator.positions(poses)
        _, true = fk.forward(root, rotations, skeleton.parents, skeleton.offsets)
        np.testing.assert_allclose(found, true, atol=1e-6)
        assert np.linalg.norm(quat.log(difference), axis=-1).max() < 1e-6


@pytest.mark.parametrize("name", MOCAP)
def test_bvh_to_verb_to_bvh_keeps_every_joint_within_a_millimetre(mocap, verb_of, name, tmp_path):
    verb = verb_of(name)
    evaluator, source = Evaluator(verb), read(mocap / name)
    for i in range(0, len(source.examples), 4):
        motion = bvh.read(source.examples[i].file)
        poses = sequence(evaluator, verb.values[i : i + 1], motion.fps, plant=False)
        bvh.write(to_motion(evaluator, poses, motion.fps), tmp_path / "out.bvh")
        back = bvh.read(tmp_path / "out.bvh")
        count = min(len(back), len(motion))
        assert count >= (source.examples[i].keytimes[-1] - source.examples[i].keytimes[0]) * motion.fps - 0.5
        _, found = fk.forward(back.root[:count], back.rotations[:count], verb.skeleton.parents, verb.skeleton.offsets)
        _, true = fk.forward(
            motion.root[:count], motion.rotations[:count], verb.skeleton.parents, verb.skeleton.offsets
        )
        true -= motion.root[0] * [1, 0, 1] if verb.looping else 0.0
        assert np.linalg.norm(found - true, axis=-1).max() < 1e-3
        assert verb.quality["curve_error_max_m"] < 1e-3


def test_adverbs_may_be_coordinates_on_a_sheet(tmp_path):
    """The same arm in rotated and shifted coordinates: the same poses."""
    rotation = np.array([[0.6, 0.8], [-0.8, 0.6]])
    plain, folder = build(arm_source(tmp_path / "plain")).verb, arm_source(tmp_path / "sheet")
    text = (folder / "verb.toml").read_text()
    for name, values in zip("abcde", plain.values, strict=True):
        sheet = (values - [0.1, 0.2]) @ rotation.T
        head, tail = text.split(f'file = "{name}.bvh"', 1)
        before, after = tail.split("adverb_values = [", 1)
        text = f'{head}file = "{name}.bvh"{before}adverb_values = {sheet.tolist()}{after.partition("]")[2]}'
    axes = [[*row, 0.0] for row in rotation.tolist()]
    goal = f"goal = {{origin = [0.1, 0.2, 0.0], axes = {axes}}}\n"
    (folder / "verb.toml").write_text(goal + text)
    sheet_verb = build(folder).verb
    adverbs = plain.values.mean(axis=0)[None]
    one = Evaluator(plain).blend(adverbs)
    other = Evaluator(sheet_verb).blend((adverbs - [0.1, 0.2]) @ rotation.T)
    assert other.error[0] < 1e-9
    np.testing.assert_allclose(other.weights, one.weights, atol=1e-6)
